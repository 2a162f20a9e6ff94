//! What a body may be made of: scalars, integers as little-endian bytes, flagged values, lists and text.

use super::layout::{About, Field, Form, Scalar, Table};
use serde::de::{DeserializeOwned, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

/// A type of fixed size that may stand in a body.
pub trait Element: Clone + Default + PartialEq + fmt::Debug + Serialize + DeserializeOwned {
    /// Bytes on the wire.
    const SIZE: usize;

    /// Name and meaning, where this is a struct of its own.
    const STRUCT: Option<(&'static str, &'static str)> = None;

    /// Appends this element to a table, under the name, unit, range and meaning that its place in the body has.
    fn describe(table: &mut Table, about: &About);
}

macro_rules! scalar {
    ($($type:ty, $scalar:ident, $size:literal;)+) => {$(
        impl Element for $type {
            const SIZE: usize = $size;
            fn describe(table: &mut Table, about: &About) {
                table.push(about, Form::Scalar(Scalar::$scalar), $size);
            }
        }
    )+};
}

scalar! {
    bool, Bool, 1;
    u8, U8, 1;
    i8, I8, 1;
    f32, F32, 4;
    f64, F64, 8;
    U16Le, U16, 2;
    U32Le, U32, 4;
    I32Le, I32, 4;
}

macro_rules! little_endian {
    ($($name:ident, $native:ty, $size:literal, $words:literal;)+) => {$(
        #[doc = $words]
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub struct $name([u8; $size]);

        impl $name {
            /// From the machine's own integer.
            pub const fn new(value: $native) -> Self {
                Self(value.to_le_bytes())
            }

            /// As the machine's own integer.
            pub const fn get(self) -> $native {
                <$native>::from_le_bytes(self.0)
            }
        }

        impl From<$native> for $name {
            fn from(value: $native) -> Self {
                Self::new(value)
            }
        }
    )+};
}

little_endian! {
    U16Le, u16, 2, "A `u16` as two bytes, lowest first.";
    U32Le, u32, 4, "A `u32` as four bytes, lowest first.";
    I32Le, i32, 4, "An `i32` as four bytes, lowest first.";
}

/// A value with its flag: on the wire `<name>_known`, then the value, which is all zero bytes where it is not known.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Maybe<T> {
    known: bool,
    value: T,
}

/// Two values that are not known are equal, whatever bytes stand in their place.
impl<T: PartialEq> PartialEq for Maybe<T> {
    fn eq(&self, other: &Self) -> bool {
        self.get() == other.get()
    }
}

impl<T: Default> Maybe<T> {
    /// A value that is not known.
    pub fn unknown() -> Self {
        Self::default()
    }
}

impl<T> Maybe<T> {
    /// The value, where it is known.
    pub fn get(&self) -> Option<&T> {
        self.known.then_some(&self.value)
    }
}

impl<T, U: Default + From<T>> From<Option<T>> for Maybe<U> {
    fn from(value: Option<T>) -> Self {
        value.map_or_else(Self::default, |value| Self { known: true, value: value.into() })
    }
}

impl<T: Element> Element for Maybe<T> {
    const SIZE: usize = 1 + T::SIZE;

    fn describe(table: &mut Table, about: &About) {
        let meaning = match T::STRUCT {
            Some(_) => format!("Whether the fields that need it are known. {}", about.meaning),
            None => format!("Whether `{}` is known.", about.name),
        };
        let flag = About { name: format!("{}_known", about.name), unit: "", range: None, meaning };
        bool::describe(table, &flag);
        table.governed(|table| T::describe(table, about));
    }
}

/// `N` elements, always all of them; a count beside the list says how many mean something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct List<T, const N: usize>([T; N]);

impl<T: Copy + Default, const N: usize> List<T, N> {
    /// The first `N` of the given, the rest at their default.
    pub fn from_slice(values: &[T]) -> Self {
        let mut list = [T::default(); N];
        list.iter_mut().zip(values).for_each(|(place, value)| *place = *value);
        Self(list)
    }
}

impl<T, const N: usize> List<T, N> {
    /// All elements.
    pub fn as_slice(&self) -> &[T] {
        &self.0
    }
}

impl<T, const N: usize> From<[T; N]> for List<T, N> {
    fn from(values: [T; N]) -> Self {
        Self(values)
    }
}

impl<T: Copy + Default, const N: usize> Default for List<T, N> {
    fn default() -> Self {
        Self([T::default(); N])
    }
}

/// As a tuple, because serde's own arrays end at 32; the bytes are the elements', one after the other.
impl<T: Serialize, const N: usize> Serialize for List<T, N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(N)?;
        for value in &self.0 {
            tuple.serialize_element(value)?;
        }
        tuple.end()
    }
}

impl<'de, T: Copy + Default + Deserialize<'de>, const N: usize> Deserialize<'de> for List<T, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Fill<T, const N: usize>(PhantomData<T>);

        impl<'de, T: Copy + Default + Deserialize<'de>, const N: usize> Visitor<'de> for Fill<T, N> {
            type Value = List<T, N>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{N} elements")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Self::Value, A::Error> {
                let mut list = List::default();
                for (index, place) in list.0.iter_mut().enumerate() {
                    *place = elements.next_element()?.ok_or_else(|| serde::de::Error::invalid_length(index, &self))?;
                }
                Ok(list)
            }
        }

        deserializer.deserialize_tuple(N, Fill(PhantomData))
    }
}

impl<T: Element + Copy, const N: usize> Element for List<T, N> {
    const SIZE: usize = N * T::SIZE;

    fn describe(table: &mut Table, about: &About) {
        let mut row = Table::default();
        T::describe(&mut row, about);
        match (T::STRUCT, row.fields.as_slice()) {
            (Some((name, meaning)), _) => {
                (row.name, row.meaning) = (name, meaning);
                table.push_many(about, Form::Rows(row), vec![N], Self::SIZE);
            }
            (None, [Field { form, dims, .. }]) => {
                let dims = std::iter::once(N).chain(dims.iter().copied()).collect();
                table.push_many(about, form.clone(), dims, Self::SIZE);
            }
            // Of what else may be listed (a flagged value) there is none; a test reads every table.
            (None, _) => {}
        }
    }
}

/// Printable ASCII, filled up with zero bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Text<const N: usize>(List<u8, N>);

impl<const N: usize> Text<N> {
    /// The first `N` characters; whatever is not printable ASCII becomes `?`.
    pub fn new(text: &str) -> Self {
        let mut bytes = [0; N];
        for (place, character) in bytes.iter_mut().zip(text.chars()) {
            *place = u8::try_from(character).ok().filter(|byte| (b' '..=b'~').contains(byte)).unwrap_or(b'?');
        }
        Self(List(bytes))
    }
}

impl<const N: usize> fmt::Display for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&super::layout::text_of(self.0.as_slice()))
    }
}

impl<const N: usize> Element for Text<N> {
    const SIZE: usize = N;

    fn describe(table: &mut Table, about: &About) {
        table.push(about, Form::Text(N), N);
    }
}

/// Declares a body, or a group of fields of one, and with it its table: `name: Type => "unit" [low, high];`.
///
/// A field's doc comment is its meaning in the interface control document. The fields of a group stand in the table of the
/// body under their own names, so names are unique in a body.
macro_rules! body {
    (
        $(#[doc = $doc:literal])+
        pub struct $name:ident {
            $( $(#[doc = $meaning:literal])+ $field:ident: $type:ty => $unit:literal $([$low:literal, $high:literal])?; )+
        }
    ) => {
        $(#[doc = $doc])+
        #[derive(Debug, Clone, Copy, Default, PartialEq, ::serde::Serialize, ::serde::Deserialize)]
        pub struct $name {
            $( $(#[doc = $meaning])+ pub $field: $type, )+
        }

        impl $crate::wire::Element for $name {
            const SIZE: usize = 0 $( + <$type as $crate::wire::Element>::SIZE )+;
            const STRUCT: Option<(&'static str, &'static str)> = Some((stringify!($name), concat!($($doc),+)));

            fn describe(table: &mut $crate::wire::Table, _about: &$crate::wire::layout::About) {
                $(
                    <$type as $crate::wire::Element>::describe(table, &$crate::wire::layout::About {
                        name: stringify!($field).to_owned(),
                        unit: $unit,
                        range: [$( ($low, $high) )?].first().copied(),
                        meaning: concat!($($meaning),+).trim().to_owned(),
                    });
                )+
            }
        }
    };
}
pub(super) use body;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_stored_lowest_byte_first() {
        assert_eq!(postcard::to_stdvec(&U32Le::new(0x0403_0201)).unwrap(), [1, 2, 3, 4]);
        assert_eq!(postcard::to_stdvec(&I32Le::new(-2)).unwrap(), [0xFE, 0xFF, 0xFF, 0xFF]);
        assert_eq!(U16Le::new(517).get(), 517);
    }

    #[test]
    fn an_unknown_value_is_all_zero_bytes() {
        let unknown: Maybe<f64> = None::<f64>.into();
        assert_eq!(postcard::to_stdvec(&unknown).unwrap(), [0; 9]);
        assert_eq!(unknown.get(), None);
        let known: Maybe<U16Le> = Some(3u16).into();
        assert_eq!(postcard::to_stdvec(&known).unwrap(), [1, 3, 0]);
    }

    #[test]
    fn a_list_longer_than_serde_knows_keeps_its_bytes() {
        let list: List<u8, 100> = List::from_slice(&[7; 60]);
        let bytes = postcard::to_stdvec(&list).unwrap();
        assert_eq!(bytes.len(), 100);
        assert_eq!(postcard::from_bytes::<List<u8, 100>>(&bytes).unwrap(), list);
        assert!(postcard::from_bytes::<List<u8, 100>>(&bytes[..99]).is_err());
    }

    #[test]
    fn text_is_cut_and_keeps_to_printable_ascii() {
        assert_eq!(Text::<4>::new("véga!").to_string(), "v?ga");
        assert_eq!(Text::<8>::new("ab").to_string(), "ab");
    }
}
