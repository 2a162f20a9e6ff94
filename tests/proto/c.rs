//! The C header, and the C program that prints golden messages, from the layout tables.

use crate::icd::flags;
use stars::command::{Act, Definition};
use stars::wire::Code;
use stars::wire::{Field, Form, MAX_FRAME, PROTOCOL_CURRENT, PROTOCOL_MIN, SYNC, Scalar, Table, schema_hash, tables};
use std::collections::HashSet;
use std::fmt::Write;

const HEAD: &str = include_str!("head.h");
const FRAMING: &str = include_str!("framing.h");
const CHECK: &str = include_str!("check.c");

/// `HorizontalPart` → `horizontal_part`.
fn snake(name: &str) -> String {
    let mut snake = String::new();
    for (place, character) in name.chars().enumerate() {
        if character.is_uppercase() && place > 0 {
            snake.push('_');
        }
        snake.extend(character.to_lowercase());
    }
    snake
}

fn struct_name(table: &Table) -> String {
    format!("stars_{}_t", snake(table.name))
}

fn type_name(form: &Form) -> String {
    match form {
        Form::Scalar(scalar) => match scalar {
            Scalar::Bool | Scalar::U8 => "uint8_t",
            Scalar::I8 => "int8_t",
            Scalar::U16 => "uint16_t",
            Scalar::U32 => "uint32_t",
            Scalar::I32 => "int32_t",
            Scalar::F32 => "float",
            Scalar::F64 => "double",
        }
        .to_owned(),
        Form::Code(_) => "uint8_t".to_owned(),
        Form::Text(_) => "char".to_owned(),
        Form::Rows(row) => struct_name(row),
    }
}

/// A table after the tables of its rows.
fn with_rows<'a>(table: &'a Table, all: &mut Vec<&'a Table>) {
    for field in &table.fields {
        if let Form::Rows(row) = &field.form {
            with_rows(row, all);
        }
    }
    all.push(table);
}

fn all_tables() -> Vec<&'static Table> {
    let mut all = Vec::new();
    tables().for_each(|(_, table)| with_rows(table, &mut all));
    all
}

/// `stars_icd.h`.
pub fn header() -> String {
    let mut text = HEAD.to_owned();
    let sync = u32::from_le_bytes(SYNC);
    let _ = writeln!(text, "#define STARS_VERSION_MIN {PROTOCOL_MIN}\n#define STARS_VERSION_CURRENT {PROTOCOL_CURRENT}");
    let _ = writeln!(text, "#define STARS_SCHEMA_HASH UINT32_C({:#010x})", schema_hash());
    let _ = writeln!(text, "#define STARS_SYNC UINT32_C({sync:#010x})\n#define STARS_MAX_FRAME {MAX_FRAME}\n");
    text.push_str("/* Kinds of message. */\nenum {\n");
    for (kind, table) in tables() {
        let _ = writeln!(text, "    STARS_KIND_{} = {},", snake(table.name).to_uppercase(), kind as u8);
    }
    text.push_str("};\n");
    let mut listed = HashSet::new();
    for field in all_tables().iter().flat_map(|table| &table.fields) {
        if let Form::Code(names) = &field.form
            && listed.insert(*names)
        {
            enumerate(field, names, &mut text);
        }
    }
    text.push_str("\n/* What to do with a command. */\nenum {\n");
    for (place, name) in Act::NAMES.iter().enumerate() {
        let _ = writeln!(text, "    STARS_ACT_{} = {},", name.to_uppercase(), place + 1);
    }
    text.push_str("};\n\n/* Commands, with their values. */\nenum {\n");
    for definition in Definition::all() {
        let name = definition.name.replace('.', "_").to_uppercase();
        let values: String = definition.parameters.iter().map(|parameter| format!(" {}", parameter.name)).collect();
        let _ = writeln!(text, "    STARS_COMMAND_{name} = {}, /*{values} */", definition.code);
    }
    text.push_str("};\n");
    for table in all_tables() {
        declare(table, &mut text);
    }
    text.push_str(FRAMING);
    text
}

fn enumerate(field: &Field, names: &[&str], text: &mut String) {
    let prefix = field.name.to_uppercase();
    let _ = writeln!(text, "\n/* Codes of `{}`; 0 is never valid. */\nenum {{", field.name);
    for (place, name) in names.iter().enumerate() {
        let _ = writeln!(text, "    STARS_{prefix}_{} = {},", name.to_uppercase(), place + 1);
    }
    text.push_str("};\n");
}

fn declare(table: &Table, text: &mut String) {
    let name = struct_name(table);
    let _ = writeln!(text, "\n/* {} */\ntypedef struct STARS_PACKED {{", table.meaning.trim());
    for field in &table.fields {
        let mut dims: String = field.dims.iter().map(|count| format!("[{count}]")).collect();
        if let Form::Text(size) = field.form {
            let _ = write!(dims, "[{size}]");
        }
        let unit = if field.unit.is_empty() { String::new() } else { format!(" [{}]", field.unit) };
        let _ = writeln!(text, "    {} {}{dims}; /* {}{unit} */", type_name(&field.form), field.name, field.meaning);
    }
    let _ = writeln!(text, "}} {name};\nSTARS_ASSERT(sizeof({name}) == {}, \"{name}\");", table.size);
    for field in &table.fields {
        let _ = writeln!(text, "STARS_ASSERT(offsetof({name}, {}) == {}, \"{name}.{0}\");", field.name, field.offset);
    }
}

/// `check.c`.
pub fn checker() -> String {
    let mut text = CHECK.to_owned();
    for table in all_tables() {
        print_function(table, &mut text);
    }
    text.push_str("static int print_body(uint8_t kind, const uint8_t *body)\n{\n    switch (kind) {\n");
    for (_, table) in tables() {
        let name = snake(table.name);
        let _ = writeln!(
            text,
            "    case STARS_KIND_{}:\n        print_{name}((const {} *)(const void *)body);\n        return 0;",
            name.to_uppercase(),
            struct_name(table)
        );
    }
    text.push_str("    default:\n        return 1;\n    }\n}\n");
    text
}

fn print_function(table: &Table, text: &mut String) {
    let _ = writeln!(text, "static void print_{}(const {} *m)\n{{", snake(table.name), struct_name(table));
    for (place, field) in table.fields.iter().enumerate() {
        let before = if place == 0 { "{" } else { ", " };
        let _ = writeln!(text, "    printf(\"{before}\\\"{}\\\": \");", field.name);
        let known: Vec<_> = flags(table, field).iter().map(|flag| format!("m->{flag}")).collect();
        if !known.is_empty() && !table.is_flag(field) {
            let _ = writeln!(text, "    if (!({}))\n        printf(\"null\");\n    else", known.join(" && "));
        }
        print_field(table, field, text);
    }
    text.push_str("    printf(\"}\");\n}\n\n");
}

fn print_field(table: &Table, field: &Field, text: &mut String) {
    let counter = format!("{}_count", field.name);
    let counted = table.fields.iter().any(|other| other.name == counter);
    let place = format!("m->{}", field.name);
    text.push_str("    {\n");
    match field.dims.as_slice() {
        [] => print_element(&field.form, &place, text),
        [count] => {
            let count = if counted { format!("m->{counter}") } else { count.to_string() };
            print_list(&count, "i", text, |text| print_element(&field.form, &format!("{place}[i]"), text));
        }
        [rows, columns, ..] => print_list(&rows.to_string(), "i", text, |text| {
            print_list(&columns.to_string(), "j", text, |text| print_element(&field.form, &format!("{place}[i][j]"), text));
        }),
    }
    text.push_str("    }\n");
}

fn print_list(count: &str, index: &str, text: &mut String, element: impl FnOnce(&mut String)) {
    let _ = writeln!(text, "        printf(\"[\");\n        for (size_t {index} = 0; {index} < {count}; {index}++) {{");
    let _ = writeln!(text, "        printf({index} ? \", \" : \"\");");
    element(text);
    text.push_str("        }\n        printf(\"]\");\n");
}

fn print_element(form: &Form, place: &str, text: &mut String) {
    let _ = match form {
        Form::Scalar(Scalar::Bool) => writeln!(text, "        printf({place} ? \"true\" : \"false\");"),
        Form::Scalar(Scalar::I8 | Scalar::I32) => writeln!(text, "        printf(\"%ld\", (long){place});"),
        Form::Scalar(Scalar::F32 | Scalar::F64) => writeln!(text, "        printf(\"%.17g\", (double){place});"),
        Form::Scalar(_) => writeln!(text, "        printf(\"%lu\", (unsigned long){place});"),
        Form::Text(size) => writeln!(text, "        print_text({place}, {size});"),
        Form::Code(names) => {
            let names: Vec<_> = names.iter().map(|name| format!("\"{name}\"")).collect();
            writeln!(text, "        print_code({place}, (const char *const[]){{{}}});", names.join(", "))
        }
        Form::Rows(row) => writeln!(text, "        print_{}(&{place});", snake(row.name)),
    };
}
