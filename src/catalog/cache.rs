//! A field in a file, so that only the first start with a camera builds its index.
//!
//! Little-endian throughout. In this order:
//!
//! | type | what |
//! |---|---|
//! | 8 bytes | `STARSIDX` |
//! | u32 | version of the layout, and of how a field is derived from its key |
//! | 13 × u64 | [`FieldKey`]: everything that the field was derived from |
//! | u32 | CRC-32 (IEEE) of the bytes before |
//! | lists, each a u64 with the number of its items, then the items | stars, their grid, index stars, their neighbours, triangles, bitmap |
//! | u32 | CRC-32 (IEEE) of all bytes before |
//!
//! What follows from the key is not in the file. No list is given memory before the file is known to be long enough for it, and none
//! of a field that was read points out of another, whatever the file says.

use super::pages::in_large_pages;
use super::{Field, FieldKey, FieldStars, SkyBitmap, TriangleIndex};
use crate::sky::Vec3;
use crc32fast::Hasher;
use std::io::{self, Read, Write};

const MAGIC: [u8; 8] = *b"STARSIDX";
/// Counted up with every change of the layout, or of how a field is derived from its key.
const FORMAT: u32 = 2;
/// The longest file that can be an index, bytes: twice what the derivation allows an index to take.
pub const MAX_FIELD_BYTES: u64 = 512 << 20;
/// What the name of every such file begins with.
pub const FILE_PREFIX: &str = "stars-field-";
/// Bytes that are read, checked and taken apart at a time: they stay in the processor's cache meanwhile.
const CHUNK_BYTES: usize = 1 << 17;
/// Why a file was not taken for the field that was asked for.
#[derive(Debug, thiserror::Error)]
pub enum FieldFileError {
    /// Not an index of ours.
    #[error("not an index of stars")]
    Foreign,
    /// Of another layout than this program's.
    #[error("index format {found}, expected {FORMAT}")]
    Format {
        /// Version of its layout.
        found: u32,
    },
    /// A field of something else.
    #[error("made for another catalogue, camera or setting")]
    Other,
    /// Too short for what it says, or longer.
    #[error("cut or altered: it is {found} bytes long, and says it has {}", if *.missing { "more" } else { "less" })]
    Length {
        /// Bytes in the file.
        found: u64,
        /// Whether there should be more.
        missing: bool,
    },
    /// Altered, by one of its checksums.
    #[error("altered: checksum is {found:08x}, expected {expected:08x}")]
    Altered {
        /// Checksum of what is there.
        found: u32,
        /// Checksum that was written with it.
        expected: u32,
    },
    /// A list that no field has.
    #[error("altered: its {list} cannot be")]
    Insane {
        /// Which.
        list: &'static str,
    },
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] io::Error),
}

impl Field {
    /// Writes the field, to be read again by [`Self::load`].
    ///
    /// # Errors
    /// Where `to` takes no more.
    pub fn save(&self, to: &mut dyn Write) -> io::Result<()> {
        let mut saver = Saver { to, checksum: Hasher::new(), chunk: Vec::with_capacity(CHUNK_BYTES) };
        saver.put(&opening(&self.key))?;
        saver.seal()?;
        self.stars.save(&mut saver)?;
        self.triangles.save(&mut saver)?;
        self.bitmap.save(&mut saver)?;
        saver.seal()
    }

    /// Reads the field with a key from a file of `length` bytes; one that is cut, altered or of something else is refused.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn load(from: &mut dyn Read, length: u64, key: &FieldKey) -> Result<Self, FieldFileError> {
        let mut loader = Loader { from, length, left: length, checksum: Hasher::new(), chunk: vec![0; CHUNK_BYTES] };
        loader.opening(key)?;
        let geometry = key.geometry();
        let stars = FieldStars::load(&mut loader, key, &geometry)?;
        let triangles = TriangleIndex::load(&mut loader, &key.density(), &geometry)?;
        let bitmap = SkyBitmap::load(&mut loader, key.tolerance())?;
        loader.unseal()?;
        match loader.left {
            0 => Ok(Self::of_parts(key, stars, triangles, bitmap)),
            _ => Err(FieldFileError::Length { found: length, missing: false }),
        }
    }
}

/// What the file of a field begins with, but for the checksum.
fn opening(key: &FieldKey) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend(FORMAT.to_le_bytes());
    bytes.extend(key.numbers().iter().flat_map(|number| number.to_le_bytes()));
    bytes
}

impl FieldKey {
    /// The name of the file that holds the field: another for another key, but for one chance in 2⁶⁴.
    pub fn file_name(&self) -> String {
        let hash = crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(&opening(self));
        format!("{FILE_PREFIX}{hash:016x}.bin")
    }
}

/// Writes the parts of a field.
pub struct Saver<'a> {
    to: &'a mut dyn Write,
    /// Of all that was written.
    checksum: Hasher,
    chunk: Vec<u8>,
}

impl Saver<'_> {
    /// Writes a list: how many items, and each as `encode` makes it.
    pub fn list<T, const N: usize>(&mut self, items: &[T], encode: impl Fn(&T) -> [u8; N]) -> io::Result<()> {
        self.put(&(items.len() as u64).to_le_bytes())?;
        for items in items.chunks((CHUNK_BYTES / N).max(1)) {
            let mut chunk = std::mem::take(&mut self.chunk);
            chunk.clear();
            for item in items {
                chunk.extend_from_slice(&encode(item));
            }
            self.put(&chunk)?;
            self.chunk = chunk;
        }
        Ok(())
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.checksum.update(bytes);
        self.to.write_all(bytes)
    }

    /// Writes the checksum of all bytes so far.
    fn seal(&mut self) -> io::Result<()> {
        let checksum = self.checksum.clone().finalize();
        self.put(&checksum.to_le_bytes())
    }
}

/// Reads the parts of a field.
pub struct Loader<'a> {
    from: &'a mut dyn Read,
    /// Bytes in the file, and those not read yet.
    length: u64,
    left: u64,
    /// Of all that was read.
    checksum: Hasher,
    chunk: Vec<u8>,
}

impl Loader<'_> {
    /// Reads a list of which each item is made by `decode`. It is given memory once the file is known to have that many.
    pub fn list<T, const N: usize>(&mut self, mut decode: impl FnMut(&[u8; N]) -> T) -> Result<Vec<T>, FieldFileError> {
        let count = u64::from_le_bytes(self.take()?);
        if count.checked_mul(N as u64).is_none_or(|bytes| bytes > self.left) {
            return Err(self.missing());
        }
        let mut left = count as usize;
        let mut items = in_large_pages(left);
        let mut chunk = std::mem::take(&mut self.chunk);
        while left > 0 {
            let count = left.min(CHUNK_BYTES / N);
            let bytes = chunk.get_mut(..count * N).unwrap_or_default();
            self.get(bytes)?;
            items.extend(bytes.as_chunks::<N>().0.iter().map(&mut decode));
            left -= count;
        }
        self.chunk = chunk;
        Ok(items)
    }

    /// Reads what a file begins with, and refuses all that is not the beginning of a field with this key.
    fn opening(&mut self, key: &FieldKey) -> Result<(), FieldFileError> {
        if self.take()? != MAGIC {
            return Err(FieldFileError::Foreign);
        }
        let found = u32::from_le_bytes(self.take()?);
        if found != FORMAT {
            return Err(FieldFileError::Format { found });
        }
        let mut same = true;
        for number in key.numbers() {
            same &= u64::from_le_bytes(self.take()?) == number;
        }
        self.unseal()?;
        if same { Ok(()) } else { Err(FieldFileError::Other) }
    }

    /// Reads the checksum of all bytes so far, and refuses another.
    fn unseal(&mut self) -> Result<(), FieldFileError> {
        let found = self.checksum.clone().finalize();
        let expected = u32::from_le_bytes(self.take()?);
        if found == expected { Ok(()) } else { Err(FieldFileError::Altered { found, expected }) }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], FieldFileError> {
        let mut bytes = [0; N];
        self.get(&mut bytes)?;
        Ok(bytes)
    }

    fn get(&mut self, bytes: &mut [u8]) -> Result<(), FieldFileError> {
        self.left = self.left.checked_sub(bytes.len() as u64).ok_or_else(|| self.missing())?;
        self.from.read_exact(bytes).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => self.missing(),
            _ => error.into(),
        })?;
        self.checksum.update(bytes);
        Ok(())
    }

    /// The file ends before what it says it has.
    fn missing(&self) -> FieldFileError {
        FieldFileError::Length { found: self.length, missing: true }
    }
}

/// Refuses a list that no field has.
pub fn sane(list: &'static str, sane: bool) -> Result<(), FieldFileError> {
    if sane { Ok(()) } else { Err(FieldFileError::Insane { list }) }
}

/// Whether these are places where the parts of a list of `items` begin, and its end.
pub fn are_offsets(offsets: &[u32], items: usize) -> bool {
    offsets.first() == Some(&0) && offsets.is_sorted() && offsets.last().is_some_and(|&end| end as usize == items)
}

/// Bytes of a direction.
pub const DIRECTION_BYTES: usize = 24;

/// A direction as it stands in a file.
pub fn direction_bytes(direction: &Vec3) -> [u8; DIRECTION_BYTES] {
    let mut bytes = [0; DIRECTION_BYTES];
    for (to, from) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(direction.iter()) {
        *to = from.to_le_bytes();
    }
    bytes
}

/// What [`direction_bytes`] wrote.
pub fn read_direction(bytes: &[u8; DIRECTION_BYTES]) -> Vec3 {
    let mut direction = Vec3::zeros();
    for (to, from) in direction.iter_mut().zip(bytes.as_chunks::<8>().0) {
        *to = f64::from_le_bytes(*from);
    }
    direction
}

/// Whether this is a unit vector.
pub fn is_direction(direction: &Vec3) -> bool {
    (direction.norm_squared() - 1.0).abs() < 1e-9
}

#[cfg(test)]
mod tests;
