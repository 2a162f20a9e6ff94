//! The telemetry and command dictionary: XTCE 1.2 (OMG formal/18-10-04) for ground systems, and a plain table for people.

use stars::command::{Definition, Hazard, Shape};
use stars::wire::{Form, Kind, Scalar, Table};
use std::fmt::Write;

/// Text that may stand in XML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The plain table of commands.
pub fn command_table() -> String {
    let mut text = "| code | command | values | armed | flown as | meaning |\n|---:|---|---|---|---|---|\n".to_owned();
    for definition in Definition::all() {
        let armed = match definition.hazard {
            Hazard::None => "",
            Hazard::Always => "always",
            Hazard::LargeMove => "large moves",
        };
        let values: Vec<_> = definition
            .parameters
            .iter()
            .map(|parameter| {
                let unit = if parameter.unit.is_empty() { String::new() } else { format!(" {}", parameter.unit) };
                format!("`{}` ({}{unit}): {}", parameter.name, parameter.expected(), parameter.meaning)
            })
            .collect();
        let flown = if definition.flown.is_empty() { String::new() } else { format!("`{}`", definition.flown) };
        let _ = writeln!(
            text,
            "| {} | `{}` | {} | {armed} | {flown} | {} |",
            definition.code,
            definition.name,
            values.join("<br>"),
            definition.meaning
        );
    }
    text
}

/// A scalar field of a flattened body: its name, what it is, its unit and meaning.
struct Flat {
    name: String,
    form: Form,
    unit: &'static str,
    meaning: String,
    bits: usize,
}

/// Every element of a body by itself: rows and lists counted out.
fn flatten(table: &Table, before: &str, flat: &mut Vec<Flat>) {
    for field in &table.fields {
        let count = if matches!(field.form, Form::Text(_)) { 1 } else { field.count() };
        for index in 0..count {
            let name = if count > 1 { format!("{before}{}_{index}", field.name) } else { format!("{before}{}", field.name) };
            match &field.form {
                Form::Rows(row) => flatten(row, &format!("{name}_"), flat),
                form => flat.push(Flat {
                    name,
                    form: form.clone(),
                    unit: field.unit,
                    meaning: field.meaning.clone(),
                    bits: 8 * field.size / count,
                }),
            }
        }
    }
}

fn units(unit: &str) -> String {
    if unit.is_empty() {
        "<xtce:UnitSet/>".to_owned()
    } else {
        format!("<xtce:UnitSet><xtce:Unit>{}</xtce:Unit></xtce:UnitSet>", escape(unit))
    }
}

fn integer(bits: usize, signed: bool) -> String {
    let encoding = if signed { "twosComplement" } else { "unsigned" };
    let order = if bits > 8 { " byteOrder=\"leastSignificantByteFirst\"" } else { "" };
    format!("<xtce:IntegerDataEncoding sizeInBits=\"{bits}\" encoding=\"{encoding}\"{order}/>")
}

fn float(bits: usize) -> String {
    format!("<xtce:FloatDataEncoding sizeInBits=\"{bits}\" encoding=\"IEEE754_1985\" byteOrder=\"leastSignificantByteFirst\"/>")
}

/// The type of a telemetry parameter.
fn parameter_type(field: &Flat) -> String {
    let (name, units) = (format!("{}_t", field.name), units(field.unit));
    match &field.form {
        Form::Scalar(Scalar::Bool) => format!(
            "<xtce:BooleanParameterType name=\"{name}\" zeroStringValue=\"false\" oneStringValue=\"true\">{units}{}</xtce:BooleanParameterType>",
            integer(8, false)
        ),
        Form::Scalar(Scalar::F32 | Scalar::F64) => format!(
            "<xtce:FloatParameterType name=\"{name}\" sizeInBits=\"{}\">{units}{}</xtce:FloatParameterType>",
            field.bits,
            float(field.bits)
        ),
        Form::Scalar(scalar) => {
            let signed = matches!(scalar, Scalar::I8 | Scalar::I32);
            format!(
                "<xtce:IntegerParameterType name=\"{name}\" signed=\"{signed}\" sizeInBits=\"{}\">{units}{}</xtce:IntegerParameterType>",
                field.bits,
                integer(field.bits, signed)
            )
        }
        Form::Code(names) => {
            // 0 stands where a value is not known.
            let listed = std::iter::once("unknown").chain(names.iter().copied()).enumerate();
            let list: String =
                listed.map(|(value, label)| format!("<xtce:Enumeration value=\"{value}\" label=\"{label}\"/>")).collect();
            format!(
                "<xtce:EnumeratedParameterType name=\"{name}\">{units}{}<xtce:EnumerationList>{list}</xtce:EnumerationList></xtce:EnumeratedParameterType>",
                integer(8, false)
            )
        }
        Form::Text(_) => format!(
            "<xtce:StringParameterType name=\"{name}\">{units}<xtce:StringDataEncoding encoding=\"US-ASCII\"><xtce:SizeInBits><xtce:Fixed><xtce:FixedValue>{}</xtce:FixedValue></xtce:Fixed></xtce:SizeInBits></xtce:StringDataEncoding></xtce:StringParameterType>",
            field.bits
        ),
        Form::Rows(_) => String::new(),
    }
}

fn telemetry(text: &mut String) {
    let mut flat = Vec::new();
    flatten(Kind::Update.table(), "", &mut flat);
    let _ = writeln!(text, "  <xtce:TelemetryMetaData>\n    <xtce:ParameterTypeSet>");
    for field in &flat {
        let _ = writeln!(text, "      {}", parameter_type(field));
    }
    let _ = writeln!(text, "    </xtce:ParameterTypeSet>\n    <xtce:ParameterSet>");
    for field in &flat {
        let (name, meaning) = (&field.name, escape(&field.meaning));
        let _ = writeln!(
            text,
            "      <xtce:Parameter name=\"{name}\" parameterTypeRef=\"{name}_t\" shortDescription=\"{meaning}\"/>"
        );
    }
    let _ = writeln!(text, "    </xtce:ParameterSet>\n    <xtce:ContainerSet>");
    let _ = writeln!(
        text,
        "      <xtce:SequenceContainer name=\"Update\" shortDescription=\"The body of a frame of kind 4\">\n        <xtce:EntryList>"
    );
    for field in &flat {
        let _ = writeln!(text, "          <xtce:ParameterRefEntry parameterRef=\"{}\"/>", field.name);
    }
    let _ = writeln!(
        text,
        "        </xtce:EntryList>\n      </xtce:SequenceContainer>\n    </xtce:ContainerSet>\n  </xtce:TelemetryMetaData>"
    );
}

/// The type of a command's value: an `f64` on the wire, whatever it means.
fn argument_type(name: &str, parameter: &stars::command::Parameter) -> String {
    let meaning = match parameter.shape {
        Shape::Choice(words) => {
            format!(
                " shortDescription=\"{}\"",
                words.iter().enumerate().map(|(n, word)| format!("{n} {word}")).collect::<Vec<_>>().join(", ")
            )
        }
        Shape::Flag => " shortDescription=\"0 or 1\"".to_owned(),
        Shape::Integer => " shortDescription=\"a whole number\"".to_owned(),
        Shape::Real => String::new(),
    };
    format!(
        "<xtce:FloatArgumentType name=\"{name}\" sizeInBits=\"64\"{meaning}>{}{}<xtce:ValidRangeSet><xtce:ValidRange minInclusive=\"{}\" maxInclusive=\"{}\"/></xtce:ValidRangeSet></xtce:FloatArgumentType>",
        units(parameter.unit),
        float(64),
        parameter.low,
        parameter.high
    )
}

fn commanding(text: &mut String) {
    let type_name = |definition: &Definition, value: &str| format!("{}.{value}_t", definition.name).replace('.', "_");
    let _ = writeln!(text, "  <xtce:CommandMetaData>\n    <xtce:ArgumentTypeSet>");
    let acts = [(1, "run"), (2, "arm"), (3, "fire")]
        .map(|(value, label)| format!("<xtce:Enumeration value=\"{value}\" label=\"{label}\"/>"))
        .concat();
    let _ = writeln!(
        text,
        "      <xtce:EnumeratedArgumentType name=\"act_t\"><xtce:UnitSet/>{}<xtce:EnumerationList>{acts}</xtce:EnumerationList></xtce:EnumeratedArgumentType>",
        integer(8, false)
    );
    let _ = writeln!(
        text,
        "      <xtce:IntegerArgumentType name=\"counter_t\" signed=\"false\" sizeInBits=\"32\"><xtce:UnitSet/>{}</xtce:IntegerArgumentType>",
        integer(32, false)
    );
    let _ = writeln!(
        text,
        "      <xtce:FloatArgumentType name=\"age_t\" sizeInBits=\"64\"><xtce:UnitSet><xtce:Unit>s</xtce:Unit></xtce:UnitSet>{}</xtce:FloatArgumentType>",
        float(64)
    );
    for definition in Definition::all() {
        for parameter in &definition.parameters {
            let _ = writeln!(text, "      {}", argument_type(&type_name(definition, parameter.name), parameter));
        }
    }
    let _ = writeln!(text, "    </xtce:ArgumentTypeSet>\n    <xtce:MetaCommandSet>");
    for definition in Definition::all() {
        meta_command(definition, &type_name, text);
    }
    let _ = writeln!(text, "    </xtce:MetaCommandSet>\n  </xtce:CommandMetaData>");
}

/// One command as a slot of a block.
fn meta_command(definition: &Definition, type_name: &impl Fn(&Definition, &str) -> String, text: &mut String) {
    let name = definition.name.replace('.', "_");
    let _ = writeln!(text, "      <xtce:MetaCommand name=\"{name}\" shortDescription=\"{}\">", escape(definition.meaning));
    let mut arguments = vec![("act", "act_t".to_owned()), ("counter", "counter_t".to_owned()), ("age_s", "age_t".to_owned())];
    arguments.extend(definition.parameters.iter().map(|parameter| (parameter.name, type_name(definition, parameter.name))));
    arguments.push(("seal", "counter_t".to_owned()));
    let list: String =
        arguments.iter().map(|(name, of)| format!("<xtce:Argument name=\"{name}\" argumentTypeRef=\"{of}\"/>")).collect();
    let _ = writeln!(text, "        <xtce:ArgumentList>{list}</xtce:ArgumentList>");
    let _ = writeln!(text, "        <xtce:CommandContainer name=\"{name}_slot\"><xtce:EntryList>");
    let _ = writeln!(text, "          <xtce:FixedValueEntry binaryValue=\"{:02x}\" sizeInBits=\"8\"/>", definition.code);
    for (name, _) in arguments.iter().take(arguments.len() - 1) {
        let _ = writeln!(text, "          <xtce:ArgumentRefEntry argumentRef=\"{name}\"/>");
    }
    let rest = 64 * (stars::command::MAX_VALUES - definition.parameters.len());
    if rest > 0 {
        let _ =
            writeln!(text, "          <xtce:FixedValueEntry binaryValue=\"{}\" sizeInBits=\"{rest}\"/>", "00".repeat(rest / 8));
    }
    let _ = writeln!(
        text,
        "          <xtce:ArgumentRefEntry argumentRef=\"seal\"/>\n        </xtce:EntryList></xtce:CommandContainer>"
    );
    if definition.hazard != Hazard::None {
        let why =
            if definition.hazard == Hazard::Always { "armed, then fired" } else { "armed, then fired, if the move is large" };
        let _ = writeln!(text, "        <xtce:DefaultSignificance consequenceLevel=\"critical\" reasonForWarning=\"{why}\"/>");
    }
    let _ = writeln!(text, "      </xtce:MetaCommand>");
}

/// The dictionary in XTCE.
pub fn xtce() -> String {
    let mut text =
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- Made from the program's declarations; not to be edited. -->\n"
            .to_owned();
    text += "<xtce:SpaceSystem xmlns:xtce=\"http://www.omg.org/spec/XTCE/20180204\" name=\"stars\" shortDescription=\"Star camera\">\n";
    telemetry(&mut text);
    commanding(&mut text);
    text + "</xtce:SpaceSystem>\n"
}
