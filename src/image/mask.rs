//! Blocks of the image that sources are not taken from.
//!
//! The numbering is that of the program that flew: block n = j × (blocks per row) + i, with i from the left and j from
//! the bottom, is bit n mod 32 (lowest first) of word n / 32.

use crate::settings::MaskSettings;
use crate::sky::RowOrder;

/// Why a mask does not fit an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MaskError {
    /// Blocks without size.
    #[error("solver.mask.block_px is 0, expected at least 1")]
    NoBlockSize,
    /// A bit is set that stands for no block.
    #[error(
        "solver.mask.fields: word {word} is {value}, which masks block {block}, but an image of {width} × {height} px has \
         {blocks} whole blocks of {block_px} px"
    )]
    NoSuchBlock {
        /// Place of the word, from 0.
        word: usize,
        /// The word.
        value: u32,
        /// Number of the block, from 0.
        block: usize,
        /// Blocks that the image has.
        blocks: usize,
        /// Side of a block, px.
        block_px: usize,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
}

/// A mask for images of one size. What lies outside the whole blocks, at the right and at the top, is never masked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mask {
    block_px: usize,
    blocks_per_row: usize,
    height: usize,
    rows: RowOrder,
    /// One for each whole block; empty where nothing is masked.
    masked: Vec<bool>,
}

impl Mask {
    /// The mask of the settings for images of a size, px, and an order of rows.
    ///
    /// # Errors
    /// A set bit beyond the last whole block: the mask is then meant for another image. A mask that is not enabled is
    /// not looked at.
    pub fn new(settings: &MaskSettings, width: usize, height: usize, rows: RowOrder) -> Result<Self, MaskError> {
        let block_px = usize::try_from(settings.block_px).unwrap_or(usize::MAX);
        if block_px == 0 {
            return Err(MaskError::NoBlockSize);
        }
        let (blocks_per_row, block_rows) = (width / block_px, height / block_px);
        let blocks = blocks_per_row * block_rows;
        let mut mask = Self { block_px, blocks_per_row, height, rows, masked: Vec::new() };
        if !settings.enabled {
            return Ok(mask);
        }
        for (word, &value) in settings.fields.iter().enumerate() {
            for bit in (0..32).filter(|bit| value >> bit & 1 == 1) {
                mask.masked.resize(blocks, false);
                let block = word * 32 + bit;
                match mask.masked.get_mut(block) {
                    Some(masked) => *masked = true,
                    None => return Err(MaskError::NoSuchBlock { word, value, block, blocks, block_px, width, height }),
                }
            }
        }
        Ok(mask)
    }

    /// Nothing is masked.
    pub fn is_empty(&self) -> bool {
        self.masked.is_empty()
    }

    /// Whether a pixel (column and row in file order) is in a masked block.
    pub fn is_masked(&self, x: usize, y: usize) -> bool {
        let from_bottom = match self.rows {
            RowOrder::BottomFirst => Some(y),
            RowOrder::TopFirst => self.height.checked_sub(y + 1),
        };
        let i = x / self.block_px;
        let block = from_bottom.filter(|_| i < self.blocks_per_row).map(|up| up / self.block_px * self.blocks_per_row + i);
        block.and_then(|n| self.masked.get(n)).copied().unwrap_or(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(fields: &[u32]) -> MaskSettings {
        MaskSettings { enabled: true, block_px: 128, fields: fields.to_vec() }
    }

    #[test]
    fn the_words_of_the_flight_mask_exactly_the_left_column() {
        let mask = Mask::new(&settings(&[16_781_313, 268_501_008, 1_048_832]), 1536, 1024, RowOrder::BottomFirst).unwrap();
        for (x, y) in (0..1536).step_by(32).flat_map(|x| (0..1024).step_by(32).map(move |y| (x, y))) {
            assert_eq!(mask.is_masked(x, y), x < 128, "{x} {y}");
        }
        assert!(mask.is_masked(127, 1023) && !mask.is_masked(128, 0));
    }

    #[test]
    fn rows_of_blocks_count_from_the_bottom_of_the_picture() {
        // Block 13: second from the left, second from the bottom.
        let bottom = Mask::new(&settings(&[1 << 13]), 1536, 1024, RowOrder::BottomFirst).unwrap();
        let top = Mask::new(&settings(&[1 << 13]), 1536, 1024, RowOrder::TopFirst).unwrap();
        for (x, y, masked) in [(128, 128, true), (255, 255, true), (127, 128, false), (256, 128, false), (128, 127, false)] {
            assert_eq!(bottom.is_masked(x, y), masked, "{x} {y}");
            assert_eq!(top.is_masked(x, 1023 - y), masked, "{x} {y} from the top");
        }
    }

    #[test]
    fn what_lies_outside_the_whole_blocks_is_never_masked() {
        // 300 × 200 px has two whole blocks in one row; the rest is at the right and at the top.
        for rows in [RowOrder::BottomFirst, RowOrder::TopFirst] {
            let mask = Mask::new(&settings(&[0b11]), 300, 200, rows).unwrap();
            let row = |up: usize| if rows == RowOrder::BottomFirst { up } else { 199 - up };
            assert!(mask.is_masked(0, row(0)) && mask.is_masked(255, row(127)));
            assert!(!mask.is_masked(256, row(0)) && !mask.is_masked(0, row(128)) && !mask.is_masked(0, row(199)));
            assert!(!mask.is_masked(5000, 5000));
        }
    }

    #[test]
    fn a_bit_beyond_the_last_block_is_an_error_that_names_the_word() {
        let error = Mask::new(&settings(&[0, 0, 0, 4]), 1536, 1024, RowOrder::BottomFirst).unwrap_err();
        assert!(error.to_string().starts_with("solver.mask.fields: word 3 is 4, which masks block 98"), "{error}");
        assert!(matches!(error, MaskError::NoSuchBlock { word: 3, blocks: 96, .. }));
        let error = Mask::new(&settings(&[1]), 100, 100, RowOrder::TopFirst).unwrap_err();
        assert!(matches!(error, MaskError::NoSuchBlock { word: 0, block: 0, blocks: 0, .. }));
        assert!(Mask::new(&settings(&[1, 0, 0, 0, 0]), 1536, 1024, RowOrder::BottomFirst).is_ok());
    }

    #[test]
    fn a_mask_that_is_empty_or_not_enabled_masks_nothing() {
        let off = MaskSettings { enabled: false, ..settings(&[u32::MAX; 9]) };
        for settings in [off, settings(&[]), settings(&[0, 0, 0])] {
            let mask = Mask::new(&settings, 1536, 1024, RowOrder::BottomFirst).unwrap();
            assert!(mask.is_empty() && !mask.is_masked(0, 0));
        }
        let no_size = MaskSettings { block_px: 0, ..settings(&[]) };
        assert_eq!(Mask::new(&no_size, 1536, 1024, RowOrder::BottomFirst), Err(MaskError::NoBlockSize));
    }
}
