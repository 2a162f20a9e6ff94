//! A body as JSON, for people and scripts: every field under its name, what is not known as null.

use super::layout::{Field, Form, Scalar, Table, text_of};
use serde_json::{Map, Number, Value};

impl Table {
    /// The fields of a checked body by name: codes and text as strings, lists cut to the count that stands beside them.
    pub fn json(&self, body: &[u8]) -> Map<String, Value> {
        // A flag is always known: under another flag that is not set, it is not set either.
        let known = |field: &Field| self.is_known(field, body) || self.is_flag(field);
        let value = |field: &Field| if known(field) { self.value(field, body) } else { Value::Null };
        self.fields.iter().map(|field| (field.name.clone(), value(field))).collect()
    }

    fn value(&self, field: &Field, body: &[u8]) -> Value {
        let bytes = field.of(body);
        match field.dims.as_slice() {
            [] => element(&field.form, bytes),
            [_] => list(&field.form, bytes, field.count()).into_iter().take(self.meaningful(field, body)).collect(),
            [rows, ..] => {
                let each = field.count() / (*rows).max(1);
                bytes
                    .chunks_exact((bytes.len() / (*rows).max(1)).max(1))
                    .map(|row| Value::from(list(&field.form, row, each)))
                    .collect()
            }
        }
    }
}

fn list(form: &Form, bytes: &[u8], count: usize) -> Vec<Value> {
    bytes.chunks_exact((bytes.len() / count.max(1)).max(1)).map(|bytes| element(form, bytes)).collect()
}

fn element(form: &Form, bytes: &[u8]) -> Value {
    match form {
        Form::Rows(row) => Value::Object(row.json(bytes)),
        Form::Text(_) => Value::from(text_of(bytes)),
        Form::Code(names) => bytes
            .first()
            .and_then(|code| names.get(usize::from(*code).checked_sub(1)?))
            .map_or(Value::Null, |name| Value::from(*name)),
        Form::Scalar(Scalar::Bool) => Value::from(bytes.first() == Some(&1)),
        Form::Scalar(scalar @ (Scalar::F32 | Scalar::F64)) => {
            scalar.read(bytes).and_then(Number::from_f64).map_or(Value::Null, Value::Number)
        }
        Form::Scalar(scalar) => scalar.read(bytes).map_or(Value::Null, |value| Value::from(value as i64)),
    }
}
