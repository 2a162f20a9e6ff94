//! The layout of a body as a table: where each field is, what it may be, what it means; and the checks made from it.

use std::borrow::Cow;

/// How a field stands in its body: given by the declaration, before its type says what it is.
#[derive(Debug, Clone, Default)]
pub struct About {
    /// Its name, the same in Rust, C, Python and JSON.
    pub name: String,
    /// Unit, empty where it has none.
    pub unit: &'static str,
    /// Least and greatest value.
    pub range: Option<(f64, f64)>,
    /// What it means.
    pub meaning: String,
}

/// A number of fixed width, little-endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum Scalar {
    Bool,
    U8,
    I8,
    U16,
    U32,
    I32,
    F32,
    F64,
}

/// What a field is.
#[derive(Debug, Clone)]
pub enum Form {
    /// A number.
    Scalar(Scalar),
    /// A closed list as one byte: the names of codes 1, 2, ….
    Code(&'static [&'static str]),
    /// Printable ASCII, so many bytes, filled up with zeros.
    Text(usize),
    /// A struct of its own, repeated.
    Rows(Table),
}

/// One field of a body.
#[derive(Debug, Clone)]
pub struct Field {
    /// Its name, the same in Rust, C, Python and JSON.
    pub name: String,
    /// Bytes from the start of its table.
    pub offset: usize,
    /// Bytes that it takes, all elements together.
    pub size: usize,
    /// What one element is.
    pub form: Form,
    /// Numbers of elements; empty for a single one.
    pub dims: Vec<usize>,
    /// Unit, empty where it has none.
    pub unit: &'static str,
    /// Least and greatest value.
    pub range: Option<(f64, f64)>,
    /// What it means.
    pub meaning: String,
    /// Places in the table of the flags that must be set for it to be known, outermost first.
    pub flags: Vec<usize>,
}

/// All fields of a body, or of a row in one.
#[derive(Debug, Clone, Default)]
pub struct Table {
    /// Name of the struct.
    pub name: &'static str,
    /// What it is for.
    pub meaning: &'static str,
    /// Bytes.
    pub size: usize,
    /// The fields, in the order of the bytes, without gaps.
    pub fields: Vec<Field>,
    /// Flags that govern whatever is appended next.
    governing: Vec<usize>,
}

/// Why a body is not what its table says.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BodyError {
    /// The body has another length than its version.
    #[error("{body} has {got} bytes, expected {expected}")]
    Length {
        /// Name of the body.
        body: &'static str,
        /// Bytes that came.
        got: usize,
        /// Bytes that its version has.
        expected: usize,
    },
    /// A field holds what it never may.
    #[error("{body}.{field}: {problem}")]
    Field {
        /// Name of the body.
        body: &'static str,
        /// Name of the field.
        field: String,
        /// What was found and what was expected.
        problem: String,
    },
    /// The bytes passed the table and not serde: the two disagree, which is a defect of this program.
    #[error("{body} does not fit its own table: {problem}")]
    Layout {
        /// Name of the body.
        body: &'static str,
        /// What postcard said.
        problem: String,
    },
}

impl Scalar {
    /// Bytes.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::U8 | Self::I8 => 1,
            Self::U16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in the first bytes; every one of these types fits an `f64` exactly. `None` where there are too few.
    pub fn read(self, bytes: &[u8]) -> Option<f64> {
        fn first<const N: usize>(bytes: &[u8]) -> Option<[u8; N]> {
            bytes.first_chunk::<N>().copied()
        }
        Some(match self {
            Self::Bool | Self::U8 => f64::from(*bytes.first()?),
            Self::I8 => f64::from(i8::from_le_bytes(first(bytes)?)),
            Self::U16 => f64::from(u16::from_le_bytes(first(bytes)?)),
            Self::U32 => f64::from(u32::from_le_bytes(first(bytes)?)),
            Self::I32 => f64::from(i32::from_le_bytes(first(bytes)?)),
            Self::F32 => f64::from(f32::from_le_bytes(first(bytes)?)),
            Self::F64 => f64::from_le_bytes(first(bytes)?),
        })
    }

    /// Writes a number that is known to lie in the type's range.
    fn write(self, bytes: &mut [u8], value: f64) {
        let put = |bytes: &mut [u8], from: &[u8]| bytes.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        match self {
            Self::Bool | Self::U8 => put(bytes, &[value as u8]),
            Self::I8 => put(bytes, &(value as i8).to_le_bytes()),
            Self::U16 => put(bytes, &(value as u16).to_le_bytes()),
            Self::U32 => put(bytes, &(value as u32).to_le_bytes()),
            Self::I32 => put(bytes, &(value as i32).to_le_bytes()),
            Self::F32 => put(bytes, &(value as f32).to_le_bytes()),
            Self::F64 => put(bytes, &value.to_le_bytes()),
        }
    }
}

impl Field {
    /// Number of elements.
    pub fn count(&self) -> usize {
        self.dims.iter().product()
    }

    /// The field's own bytes in a body.
    pub fn of<'a>(&self, body: &'a [u8]) -> &'a [u8] {
        body.get(self.offset..self.offset + self.size).unwrap_or_default()
    }

    fn of_mut<'a>(&self, body: &'a mut [u8]) -> &'a mut [u8] {
        body.get_mut(self.offset..self.offset + self.size).unwrap_or_default()
    }

    /// Bytes of one element.
    fn step(&self) -> usize {
        (self.size / self.count().max(1)).max(1)
    }

    fn in_range(&self, value: f64) -> bool {
        self.range.is_none_or(|(low, high)| (low..=high).contains(&value))
    }
}

impl Table {
    /// Appends a single element.
    pub fn push(&mut self, about: &About, form: Form, size: usize) {
        self.push_many(about, form, Vec::new(), size);
    }

    /// Appends a list of elements that take `size` bytes together.
    pub fn push_many(&mut self, about: &About, form: Form, dims: Vec<usize>, size: usize) {
        let About { name, unit, range, meaning } = about.clone();
        let flags = self.governing.clone();
        self.fields.push(Field { name, offset: self.size, size, form, dims, unit, range, meaning, flags });
        self.size += size;
    }

    /// Appends what the flag that was appended last governs.
    pub fn governed(&mut self, append: impl FnOnce(&mut Self)) {
        self.governing.push(self.fields.len().saturating_sub(1));
        append(self);
        self.governing.pop();
    }

    /// Whether all flags that govern a field are set in a body.
    pub fn is_known(&self, field: &Field, body: &[u8]) -> bool {
        let set = |place: &usize| self.fields.get(*place).is_some_and(|flag| flag.of(body).first() == Some(&1));
        field.flags.iter().all(set)
    }

    /// Makes a field zero bytes, and says so, where the flag that governs it is not set: the innermost is enough where fields are gone
    /// through in their order, since a flag that is itself not known is zero by then.
    fn forget_unknown(&self, field: &Field, body: &mut [u8]) -> bool {
        let flag = field.flags.last().and_then(|place| self.fields.get(*place));
        let unknown = flag.is_some_and(|flag| body.get(flag.offset) != Some(&1));
        if unknown {
            field.of_mut(body).fill(0);
        }
        unknown
    }

    /// Whether a field is the flag of another.
    pub fn is_flag(&self, field: &Field) -> bool {
        let named = |place: &usize| self.fields.get(*place).is_some_and(|flag| flag.offset == field.offset);
        self.fields.iter().any(|other| other.flags.last().is_some_and(named))
    }

    /// How many rows or elements of a field mean something: what `<name>_count` says where there is such a field.
    pub fn meaningful(&self, field: &Field, body: &[u8]) -> usize {
        let counter = format!("{}_count", field.name);
        let said = self.fields.iter().find(|other| other.name == counter).and_then(|other| match other.form {
            Form::Scalar(scalar) => scalar.read(other.of(body)),
            _ => None,
        });
        said.map_or(field.count(), |count| field.count().min(count as usize))
    }

    /// Checks a body that came from outside: its length, and in every field that flags are 0 or 1, floats finite, text
    /// printable, and what no flag governs a valid code and in range.
    pub fn check(&self, body: &[u8]) -> Result<(), BodyError> {
        if body.len() != self.size {
            return Err(BodyError::Length { body: self.name, got: body.len(), expected: self.size });
        }
        self.check_fields(body).map_err(|(field, problem)| BodyError::Field { body: self.name, field, problem })
    }

    fn check_fields(&self, body: &[u8]) -> Result<(), (String, String)> {
        for field in &self.fields {
            // Most fields are one number, and nearly all of them are fit: those need no further look.
            let is_number = matches!(field.form, Form::Scalar(scalar) if scalar != Scalar::Bool);
            if is_number && field.is_single() && field.is_fit(field.of(body)) {
                continue;
            }
            let known = self.is_known(field, body);
            for (index, element) in field.of(body).chunks_exact(field.step()).enumerate() {
                let problem = match &field.form {
                    Form::Rows(row) => {
                        row.check_fields(element).err().map(|(name, problem)| (format!("[{index}].{name}"), problem))
                    }
                    _ => field.problem(element, known).map(|problem| (String::new(), problem)),
                };
                if let Some((inner, problem)) = problem {
                    return Err((format!("{}{inner}", field.name), problem));
                }
            }
        }
        Ok(())
    }

    /// Makes a body safe to believe, and counts what had to be withheld. A value out of range or not finite loses its flag,
    /// so that it is not known rather than wrong; without a flag it takes the nearest value of its range. Whatever is not
    /// known becomes zero bytes.
    pub fn settle(&self, body: &mut [u8]) -> u32 {
        let mut withheld = 0;
        for field in &self.fields {
            if self.forget_unknown(field, body) || matches!(field.form, Form::Text(_)) {
                continue;
            }
            if let Form::Rows(row) = &field.form {
                withheld += field.of_mut(body).chunks_exact_mut(field.step()).map(|element| row.settle(element)).sum::<u32>();
            } else if !field.are_fit(field.of(body)) {
                withheld += 1;
                match field.flags.last().and_then(|place| self.fields.get(*place)) {
                    Some(flag) => flag.of_mut(body).fill(0),
                    None => field.of_mut(body).chunks_exact_mut(field.step()).for_each(|element| field.confine(element)),
                }
            }
        }
        if withheld > 0 {
            // What stood before the field that lost their flag.
            for field in &self.fields {
                self.forget_unknown(field, body);
            }
        }
        withheld
    }
}

impl Field {
    /// What one element holds that it never may.
    fn problem(&self, element: &[u8], known: bool) -> Option<String> {
        match &self.form {
            Form::Text(_) if !is_text(element) => Some("not printable ASCII filled up with zeros".to_owned()),
            Form::Text(_) | Form::Rows(_) => None,
            Form::Code(names) => {
                let code = element.first().copied().unwrap_or_default();
                (known && !is_code(code, names)).then(|| format!("{code} is no code, expected 1 to {}", names.len()))
            }
            Form::Scalar(scalar) => {
                let value = scalar.read(element).unwrap_or(f64::NAN);
                match scalar {
                    Scalar::Bool if value > 1.0 => Some(format!("{value} is no flag, expected 0 or 1")),
                    _ if !value.is_finite() => Some(format!("{value} is not finite")),
                    _ if self.flags.is_empty() && !self.in_range(value) => {
                        let (low, high) = self.range.unwrap_or_default();
                        Some(format!("{value} is not within {low} to {high}"))
                    }
                    _ => None,
                }
            }
        }
    }

    fn is_single(&self) -> bool {
        self.dims.is_empty()
    }

    fn are_fit(&self, elements: &[u8]) -> bool {
        if self.is_single() {
            self.is_fit(elements)
        } else {
            elements.chunks_exact(self.step()).all(|element| self.is_fit(element))
        }
    }

    fn is_fit(&self, element: &[u8]) -> bool {
        match &self.form {
            Form::Scalar(scalar) => scalar.read(element).is_some_and(|value| value.is_finite() && self.in_range(value)),
            Form::Code(names) => element.first().is_some_and(|code| is_code(*code, names)),
            Form::Text(_) | Form::Rows(_) => true,
        }
    }

    /// Puts the nearest value of the range in the place of one that is not fit.
    fn confine(&self, element: &mut [u8]) {
        let Form::Scalar(scalar) = self.form else { return };
        let (low, high) = self.range.unwrap_or((f64::MIN, f64::MAX));
        let value = scalar.read(element).filter(|value| !value.is_nan()).unwrap_or(0.0);
        scalar.write(element, value.clamp(low, high));
    }
}

fn is_code(code: u8, names: &[&str]) -> bool {
    (1..=names.len()).contains(&usize::from(code))
}

/// Printable ASCII, then zeros alone.
fn is_text(bytes: &[u8]) -> bool {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    bytes.iter().enumerate().all(|(place, byte)| if place < end { (b' '..=b'~').contains(byte) } else { *byte == 0 })
}

/// The text before the first zero byte.
pub(super) fn text_of(bytes: &[u8]) -> Cow<'_, str> {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(bytes.get(..end).unwrap_or_default())
}
