//! Messages: what a frame may carry, from bytes and to bytes.

use super::frame::{crc32, put_frame, skip_to_sync, take_frame};
use super::layout::{About, BodyError};
use super::{
    Commands, Element, Form, Gyro, Hello, ImageChunk, ImageRefusal, ImageRequest, MAX_FRAME, Refuse, Scalar, Status, Table,
    Update,
};
use bytes::BytesMut;
use std::fmt::Write;
use std::sync::LazyLock;

/// Lowest version of the protocol that this program still speaks.
pub const PROTOCOL_MIN: u8 = 1;
/// Highest version of the protocol that this program speaks.
pub const PROTOCOL_CURRENT: u8 = 3;
/// Bytes of an [`Update`] in versions 1 and 2; the other bodies of these versions are as they were.
const UPDATE_V1: usize = 1348;
const UPDATE_V2: usize = 4574;

/// Codes that a closed list of an [`Update`] has got after its first version.
struct LaterCodes {
    field: &'static str,
    /// The version with the new codes, and the last code before.
    since: u8,
    last: u8,
    /// What stands for them in earlier versions; where there is nothing, the field is not known.
    instead: Option<u8>,
}

const LATER_CODES: [LaterCodes; 4] = [
    LaterCodes { field: "last_refusal", since: 2, last: 9, instead: None },
    LaterCodes { field: "mode", since: 3, last: 2, instead: Some(2) },
    // What a clock follows is not told: it is synchronised.
    LaterCodes { field: "clock_quality", since: 3, last: 3, instead: Some(3) },
    LaterCodes { field: "captured_quality", since: 3, last: 3, instead: Some(3) },
];
/// A stream that goes on for this long without one whole frame is none of ours, bytes.
pub const MAX_GARBAGE: usize = MAX_FRAME;

/// What kind of message a frame carries; the value is the code on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Kind {
    /// [`Hello`].
    Hello = 1,
    /// [`Refuse`].
    Refuse = 2,
    /// [`Status`].
    Status = 3,
    /// [`Update`].
    Update = 4,
    /// [`Gyro`].
    Gyro = 5,
    /// [`Commands`], from version 2 on.
    Commands = 6,
    /// [`ImageRequest`], from version 3 on.
    ImageRequest = 7,
    /// [`ImageChunk`], from version 3 on.
    ImageChunk = 8,
    /// [`ImageRefusal`], from version 3 on.
    ImageRefusal = 9,
}

/// One message.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the names are those of the bodies")]
pub enum Message {
    Hello(Box<Hello>),
    Refuse(Box<Refuse>),
    Status(Box<Status>),
    Update(Box<Update>),
    Gyro(Box<Gyro>),
    Commands(Box<Commands>),
    ImageRequest(Box<ImageRequest>),
    ImageChunk(Box<ImageChunk>),
    ImageRefusal(Box<ImageRefusal>),
}

/// Why bytes are not a message.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WireError {
    /// A frame beyond the limit.
    #[error("frame of {bytes} bytes, at most {MAX_FRAME} are allowed")]
    TooLong {
        /// Bytes of the whole frame, as its length says.
        bytes: usize,
    },
    /// A frame that cannot even hold kind, version and checksum.
    #[error("frame length {length}, at least 6 are needed")]
    TooShort {
        /// What the frame's length says.
        length: usize,
    },
    /// The checksum does not fit.
    #[error("checksum {said:#010x}, computed {computed:#010x}")]
    BadChecksum {
        /// Of the bytes that came.
        computed: u32,
        /// In the frame.
        said: u32,
    },
    /// A kind of message that this program does not know.
    #[error("unknown kind of message {0}, expected 1 to {last}", last = Kind::ALL.len())]
    UnknownKind(u8),
    /// A version that is no longer, or was never, spoken.
    #[error("version {0} of a message, {PROTOCOL_MIN} and later are spoken")]
    BadVersion(u8),
    /// A body that is not what its kind and version say.
    #[error("bad body: {0}")]
    BadBody(#[from] BodyError),
    /// No frame for too long.
    #[error("no whole frame in {0} bytes")]
    NoSync(usize),
}

impl WireError {
    /// A word for counting errors by kind.
    pub fn label(&self) -> &'static str {
        match self {
            Self::TooLong { .. } => "too_long",
            Self::TooShort { .. } => "too_short",
            Self::BadChecksum { .. } => "bad_checksum",
            Self::UnknownKind(_) => "unknown_kind",
            Self::BadVersion(_) => "bad_version",
            Self::BadBody(_) => "bad_body",
            Self::NoSync(_) => "no_sync",
        }
    }
}

impl Kind {
    /// Every kind, in the order of the codes.
    pub const ALL: [Self; 9] = [
        Self::Hello,
        Self::Refuse,
        Self::Status,
        Self::Update,
        Self::Gyro,
        Self::Commands,
        Self::ImageRequest,
        Self::ImageChunk,
        Self::ImageRefusal,
    ];

    /// The kind with a code.
    pub fn from_code(code: u8) -> Result<Self, WireError> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == code).ok_or(WireError::UnknownKind(code))
    }

    /// Bytes of its body in a version that is spoken; `None` where that version has no such message.
    pub fn size_in(self, version: u8) -> Option<usize> {
        match (version, self) {
            (1, Self::Commands) | (1 | 2, Self::ImageRequest | Self::ImageChunk | Self::ImageRefusal) => None,
            (1, Self::Update) => Some(UPDATE_V1),
            (2, Self::Update) => Some(UPDATE_V2),
            _ => Some(self.table().size),
        }
    }

    /// The layout of its body in the current version.
    pub fn table(self) -> &'static Table {
        static TABLES: LazyLock<[Table; 9]> = LazyLock::new(|| {
            [
                table::<Hello>(),
                table::<Refuse>(),
                table::<Status>(),
                table::<Update>(),
                table::<Gyro>(),
                table::<Commands>(),
                table::<ImageRequest>(),
                table::<ImageChunk>(),
                table::<ImageRefusal>(),
            ]
        });
        let [hello, refuse, status, update, gyro, commands, image_request, image_chunk, image_refusal] = &*TABLES;
        match self {
            Self::Hello => hello,
            Self::Refuse => refuse,
            Self::Status => status,
            Self::Update => update,
            Self::Gyro => gyro,
            Self::Commands => commands,
            Self::ImageRequest => image_request,
            Self::ImageChunk => image_chunk,
            Self::ImageRefusal => image_refusal,
        }
    }
}

/// Every kind of message with the layout of its body.
pub fn tables() -> impl Iterator<Item = (Kind, &'static Table)> {
    Kind::ALL.into_iter().map(|kind| (kind, kind.table()))
}

fn table<T: Element>() -> Table {
    let mut table = Table::default();
    T::describe(&mut table, &About::default());
    if let Some((name, meaning)) = T::STRUCT {
        (table.name, table.meaning) = (name, meaning);
    }
    table
}

/// CRC-32 over the layout of every body: kind, then each field's place, name, type, dimensions and unit. Two programs with
/// the same number lay out their messages alike.
pub fn schema_hash() -> u32 {
    static HASH: LazyLock<u32> = LazyLock::new(|| {
        let mut text = String::new();
        for (kind, table) in tables() {
            let _ = writeln!(text, "{} {}", kind as u8, table.name);
            write_layout(table, &mut text);
        }
        crc32(text.as_bytes())
    });
    *HASH
}

fn write_layout(table: &Table, text: &mut String) {
    for field in &table.fields {
        let _ = write!(text, "{} {} {:?} {} ", field.offset, field.name, field.dims, field.unit);
        match &field.form {
            Form::Rows(row) => {
                let _ = writeln!(text, "{}", row.name);
                write_layout(row, text);
            }
            Form::Code(names) => {
                let _ = writeln!(text, "{names:?}");
            }
            Form::Text(size) => {
                let _ = writeln!(text, "text {size}");
            }
            Form::Scalar(scalar) => {
                let _ = writeln!(text, "{}", scalar.name());
            }
        }
    }
}

impl Scalar {
    /// Its name in Rust.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::F32 => "f32",
            Self::F64 => "f64",
        }
    }
}

impl Message {
    /// Its kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Hello(_) => Kind::Hello,
            Self::Refuse(_) => Kind::Refuse,
            Self::Status(_) => Kind::Status,
            Self::Update(_) => Kind::Update,
            Self::Gyro(_) => Kind::Gyro,
            Self::Commands(_) => Kind::Commands,
            Self::ImageRequest(_) => Kind::ImageRequest,
            Self::ImageChunk(_) => Kind::ImageChunk,
            Self::ImageRefusal(_) => Kind::ImageRefusal,
        }
    }

    /// The body's bytes in the current version, settled: what is not finite or out of range is not sent as if it were known.
    pub fn body(&self) -> Result<Vec<u8>, WireError> {
        let encoded = match self {
            Self::Hello(body) => postcard::to_stdvec(body),
            Self::Refuse(body) => postcard::to_stdvec(body),
            Self::Status(body) => postcard::to_stdvec(body),
            Self::Update(body) => postcard::to_stdvec(body),
            Self::Gyro(body) => postcard::to_stdvec(body),
            Self::Commands(body) => postcard::to_stdvec(body),
            Self::ImageRequest(body) => postcard::to_stdvec(body),
            Self::ImageChunk(body) => postcard::to_stdvec(body),
            Self::ImageRefusal(body) => postcard::to_stdvec(body),
        };
        let table = self.kind().table();
        let mut bytes = encoded.map_err(|error| BodyError::Layout { body: table.name, problem: error.to_string() })?;
        table.settle(&mut bytes);
        Ok(bytes)
    }

    /// Appends the message as a frame of the current version.
    pub fn encode(&self, out: &mut BytesMut) -> Result<(), WireError> {
        self.encode_in(PROTOCOL_CURRENT, out)
    }

    /// Appends the message as a frame of a version that is spoken.
    pub fn encode_in(&self, version: u8, out: &mut BytesMut) -> Result<(), WireError> {
        let kind = self.kind();
        let size = kind.size_in(version).ok_or(WireError::BadVersion(version))?;
        let mut body = self.body()?;
        if kind == Kind::Update {
            withhold_later_codes(version, kind.table(), &mut body);
        }
        put_frame(kind as u8, version, body.get(..size).unwrap_or(&body), out)
    }

    /// Reads a body, and says how many of its values were out of range and are therefore not known.
    ///
    /// A body may only grow at its end, so of a version later than ours the part that we know is read and the rest left, and of
    /// an earlier one the rest is at its default. A body of a version that is spoken has exactly its length.
    pub fn decode(kind: u8, version: u8, body: &[u8]) -> Result<(Self, u32), WireError> {
        if version < PROTOCOL_MIN {
            return Err(WireError::BadVersion(version));
        }
        let kind = Kind::from_code(kind)?;
        let table = kind.table();
        let size = kind.size_in(version).ok_or(WireError::BadVersion(version))?;
        let ours = if version > PROTOCOL_CURRENT { body.get(..size).unwrap_or(body) } else { body };
        if ours.len() != size {
            return Err(BodyError::Length { body: table.name, got: ours.len(), expected: size }.into());
        }
        let mut bytes = ours.to_vec();
        if size < table.size {
            bytes.extend_from_slice(Self::Update(Box::default()).body()?.get(size..).unwrap_or_default());
        }
        table.check(&bytes)?;
        let withheld = table.settle(&mut bytes);
        let message = match kind {
            Kind::Hello => Self::Hello(read(&bytes, table)?),
            Kind::Refuse => Self::Refuse(read(&bytes, table)?),
            Kind::Status => Self::Status(read(&bytes, table)?),
            Kind::Update => Self::Update(read(&bytes, table)?),
            Kind::Gyro => Self::Gyro(read(&bytes, table)?),
            Kind::Commands => Self::Commands(read(&bytes, table)?),
            Kind::ImageRequest => Self::ImageRequest(read(&bytes, table)?),
            Kind::ImageChunk => Self::ImageChunk(read(&bytes, table)?),
            Kind::ImageRefusal => Self::ImageRefusal(read(&bytes, table)?),
        };
        Ok((message, withheld))
    }

    /// The fields by name, what is not known as null.
    pub fn json(&self) -> Result<serde_json::Map<String, serde_json::Value>, WireError> {
        Ok(self.kind().table().json(&self.body()?))
    }
}

/// Has a version say what it has no code for in another way, or not at all.
fn withhold_later_codes(version: u8, table: &Table, body: &mut [u8]) {
    for later in LATER_CODES.iter().filter(|later| version < later.since) {
        let Some(field) = table.fields.iter().find(|field| field.name == later.field) else { continue };
        let flag = field.flags.last().filter(|_| later.instead.is_none()).and_then(|place| table.fields.get(*place));
        if body.get(field.offset).is_some_and(|code| *code > later.last) {
            if let Some(code) = body.get_mut(field.offset) {
                *code = later.instead.unwrap_or_default();
            }
            if let Some(known) = flag.and_then(|flag| body.get_mut(flag.offset)) {
                *known = 0;
            }
        }
    }
}

/// Reads a whole body; bytes left over are an error, which postcard's `from_bytes` would pass over.
fn read<T: Element>(bytes: &[u8], table: &Table) -> Result<Box<T>, BodyError> {
    let layout = |problem: String| BodyError::Layout { body: table.name, problem };
    match postcard::take_from_bytes::<T>(bytes) {
        Ok((body, [])) => Ok(Box::new(body)),
        Ok((_, rest)) => Err(layout(format!("{} bytes left over", rest.len()))),
        Err(error) => Err(layout(error.to_string())),
    }
}

/// Takes messages from a stream, wherever in it the reading begins. Holds no bytes itself.
///
/// A connection is closed at the first error. Who reads on, a recorded stream for instance, finds the next frame that is whole.
#[derive(Debug, Clone, Default)]
pub struct Reader {
    /// Bytes that were no part of a frame.
    pub skipped_bytes: u64,
    /// Values that were out of range and are not known therefore.
    pub values_withheld: u32,
    /// Bytes skipped since the last whole frame.
    garbage: usize,
}

impl Reader {
    /// The next message in the buffer; `None` where more bytes are needed.
    ///
    /// The buffer never needs more than [`MAX_FRAME`] bytes for this to go on.
    pub fn next(&mut self, buffer: &mut BytesMut) -> Result<Option<Message>, WireError> {
        let skipped = skip_to_sync(buffer);
        self.skipped_bytes = self.skipped_bytes.saturating_add(skipped as u64);
        self.garbage = self.garbage.saturating_add(skipped);
        if self.garbage > MAX_GARBAGE {
            return Err(WireError::NoSync(std::mem::take(&mut self.garbage)));
        }
        let Some(frame) = take_frame(buffer)? else { return Ok(None) };
        self.garbage = 0;
        let (message, withheld) = Message::decode(frame.kind, frame.version, &frame.body)?;
        self.values_withheld = self.values_withheld.saturating_add(withheld);
        Ok(Some(message))
    }
}

/// Everything in a recorded stream: each message or why it is none. For tests, fuzzing and reading what was captured.
pub fn decode_all(stream: &[u8]) -> Vec<Result<Message, WireError>> {
    let (mut reader, mut buffer) = (Reader::default(), BytesMut::from(stream));
    std::iter::from_fn(|| reader.next(&mut buffer).transpose()).collect()
}
