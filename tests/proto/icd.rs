//! The tables of the interface control document, and `schema.json`, from the layout tables.

use serde_json::{Value, json};
use stars::command::{Definition, Parameter, Shape};
use stars::wire::{Field, Form, Kind, MAX_FRAME, OVERHEAD, PROTOCOL_CURRENT, PROTOCOL_MIN, SYNC, Table, schema_hash, tables};
use std::fmt::Write;

/// What a field is, in words of Rust: the words of the profile.
fn type_name(form: &Form, dims: &[usize]) -> String {
    let element = match form {
        Form::Scalar(scalar) => scalar.name().to_owned(),
        Form::Code(_) => "code".to_owned(),
        Form::Text(size) => format!("text {size}"),
        Form::Rows(row) => row.name.to_owned(),
    };
    match dims {
        [] => element,
        dims => format!("{element} {}", dims.iter().map(|count| format!("[{count}]")).collect::<String>()),
    }
}

fn range(field: &Field) -> String {
    match (&field.form, field.range) {
        (Form::Code(names), _) => format!("1 to {}", names.len()),
        (_, Some((low, high))) => format!("{} to {}", number(low), number(high)),
        (_, None) => String::new(),
    }
}

fn number(value: f64) -> String {
    if value.abs() < 1e6 { value.to_string() } else { format!("{value:e}") }
}

/// Names of the flags that must be set for a field to be known.
pub fn flags<'a>(table: &'a Table, field: &Field) -> Vec<&'a str> {
    field.flags.iter().filter_map(|place| table.fields.get(*place)).map(|flag| flag.name.as_str()).collect()
}

/// The generated part of the document for one kind of message.
pub fn section(kind: Kind, table: &Table) -> String {
    let mut text = format!(
        "{}\n\nKind {}, {} bytes of body, {} of frame.\n",
        table.meaning.trim(),
        kind as u8,
        table.size,
        table.size + OVERHEAD
    );
    rows(table, &mut text);
    text
}

fn rows(table: &Table, text: &mut String) {
    let _ = writeln!(text, "\n| at | field | type | unit | range | known if | meaning |\n|---:|---|---|---|---|---|---|");
    for field in &table.fields {
        // The innermost flag alone: an outer one that is not set clears it too.
        let known_if = flags(table, field).last().map(|flag| format!("`{flag}`")).unwrap_or_default();
        let _ = writeln!(
            text,
            "| {} | `{}` | {} | {} | {} | {known_if} | {} |",
            field.offset,
            field.name,
            type_name(&field.form, &field.dims),
            field.unit,
            range(field),
            field.meaning
        );
    }
    for field in &table.fields {
        if let Form::Code(names) = &field.form {
            let codes: Vec<_> = names.iter().enumerate().map(|(place, name)| format!("{} {name}", place + 1)).collect();
            let _ = writeln!(text, "\nCodes of `{}`: {}.", field.name, codes.join(", "));
        }
    }
    for field in &table.fields {
        if let Form::Rows(row) = &field.form {
            let _ = writeln!(text, "\nEach of `{}`, {} bytes: {}", field.name, row.size, row.meaning.trim());
            rows(row, text);
        }
    }
}

/// The generated part that gives the numbers of the framing.
pub fn framing() -> String {
    format!(
        "| what | value |\n|---|---|\n| sync word, in the order of the bytes | `{SYNC:02X?}` |\n| longest frame, everything counted | {MAX_FRAME} bytes |\n\
         | bytes of a frame besides its body | {OVERHEAD} |\n| versions spoken | {PROTOCOL_MIN} to {PROTOCOL_CURRENT} |\n| schema hash of version {PROTOCOL_CURRENT} | `{:#010x}` |\n",
        schema_hash()
    )
}

/// Everything that the tables say, for programs.
pub fn schema() -> Value {
    let messages: Vec<_> = tables()
        .map(|(kind, table)| {
            let mut message = describe(table);
            message["kind"] = json!(kind as u8);
            message
        })
        .collect();
    json!({
        "version_min": PROTOCOL_MIN,
        "version_current": PROTOCOL_CURRENT,
        "schema_hash": schema_hash(),
        "sync": SYNC,
        "max_frame": MAX_FRAME,
        "messages": messages,
        "commands": commands(),
    })
}

/// Every command with its values.
fn commands() -> Vec<Value> {
    let parameter = |parameter: &Parameter| {
        let words = match parameter.shape {
            Shape::Choice(words) => json!(words),
            _ => Value::Null,
        };
        json!({
            "name": parameter.name, "unit": parameter.unit, "range": [parameter.low, parameter.high],
            "whole": parameter.shape != Shape::Real, "words": words, "meaning": parameter.meaning,
        })
    };
    let command = |definition: &Definition| {
        json!({
            "code": definition.code, "name": definition.name, "meaning": definition.meaning,
            "armed": format!("{:?}", definition.hazard),
            "values": definition.parameters.iter().map(parameter).collect::<Vec<_>>(),
        })
    };
    Definition::all().iter().map(command).collect()
}

fn describe(table: &Table) -> Value {
    let fields: Vec<_> = table
        .fields
        .iter()
        .map(|field| {
            let mut entry = json!({
                "name": field.name,
                "offset": field.offset,
                "size": field.size,
                "type": type_name(&field.form, &[]),
                "dims": field.dims,
                "unit": field.unit,
                "range": field.range.map(|(low, high)| [low, high]),
                "known_if": flags(table, field),
                "meaning": field.meaning,
            });
            match &field.form {
                Form::Code(names) => entry["codes"] = json!(names),
                Form::Rows(row) => entry["row"] = describe(row),
                _ => {}
            }
            entry
        })
        .collect();
    json!({ "name": table.name, "meaning": table.meaning.trim(), "size": table.size, "fields": fields })
}
