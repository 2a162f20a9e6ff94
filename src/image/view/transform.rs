//! The picture in resolutions: the S transform in place, and the order in which its coefficients are sent.
//!
//! Of two neighbours the transform keeps the mean, rounded down, and the difference, from which both follow exactly; then of two means,
//! and so on, in rows and columns (S transform: Said and Pearlman, IEEE Trans. Image Process. 5, 1303, 1996, § II). It takes blocks of
//! 16 × 16 px, which know nothing of each other: what is lost of one spoils no other. Longer filters gain on smooth pictures; these are
//! noise of some ADU on a background without detail, of which they gain nothing.

#![allow(clippy::indexing_slicing, reason = "a kernel; places are made from the size of the plane that they index")]

/// Halvings.
const LEVELS: usize = 4;
/// Columns and rows of a block, px.
pub(super) const BLOCK_PX: usize = 1 << LEVELS;
/// Kinds of coefficients: the mean of a block, and for each level differences along one axis and along both.
pub(super) const CLASSES: usize = 1 + 2 * LEVELS;
/// The class of a block's mean.
pub(super) const MEAN: u8 = 0;
/// Blocks within this distance of a source along either axis are sent first, px: the reach of a star's image.
const REACH_PX: usize = 5;

/// Mean and difference instead of two values.
fn split(a: &mut i32, b: &mut i32) {
    let difference = *a - *b;
    (*a, *b) = (*b + (difference >> 1), difference);
}

/// The two values again.
fn join(a: &mut i32, b: &mut i32) {
    let second = *a - (*b >> 1);
    (*a, *b) = (second + *b, second);
}

/// Transforms a plane in place: a coefficient stands where the second of its two values stood.
pub(super) fn forward(plane: &mut [i32], width: usize) {
    for step in (0..LEVELS).map(|level| 1 << level) {
        along_rows(plane, width, step, split);
        along_columns(plane, width, step, split);
    }
}

/// The plane again, exactly.
pub(super) fn inverse(plane: &mut [i32], width: usize) {
    for step in (0..LEVELS).rev().map(|level| 1 << level) {
        along_columns(plane, width, step, join);
        along_rows(plane, width, step, join);
    }
}

fn along_rows(plane: &mut [i32], width: usize, step: usize, pair: impl Fn(&mut i32, &mut i32)) {
    for row in plane.chunks_mut(width).step_by(step) {
        for cell in row.chunks_mut(2 * step) {
            if let (near, [second, ..]) = cell.split_at_mut(step.min(cell.len())) {
                pair(&mut near[0], second);
            }
        }
    }
}

fn along_columns(plane: &mut [i32], width: usize, step: usize, pair: impl Fn(&mut i32, &mut i32)) {
    for rows in plane.chunks_mut(2 * step * width) {
        let (first, second) = rows.split_at_mut((step * width).min(rows.len()));
        let second = second.iter_mut().take(width);
        first.iter_mut().zip(second).step_by(step).for_each(|(a, b)| pair(a, b));
    }
}

/// The order in which coefficients are sent: all of the blocks that have sources, then the means of the others, then their differences
/// from the coarsest level to the finest.
#[derive(Debug)]
pub(super) struct Order {
    /// Where each coefficient stands in the plane.
    pub places: Vec<u32>,
    /// Its class.
    pub classes: Vec<u8>,
    width: usize,
    height: usize,
    /// Blocks of a row.
    across: usize,
    /// Blocks that are sent already, row by row.
    sent: Vec<bool>,
}

impl Order {
    /// The order for a picture of this size with sources at these pixels, the most important first.
    pub fn new(width: usize, height: usize, sources: impl Iterator<Item = (usize, usize)>) -> Self {
        let (across, down) = (width.div_ceil(BLOCK_PX), height.div_ceil(BLOCK_PX));
        let (places, classes) = (Vec::with_capacity(width * height), Vec::with_capacity(width * height));
        let mut order = Self { places, classes, width, height, across, sent: vec![false; across * down] };
        let reached = |at: usize, end: usize| at.saturating_sub(REACH_PX) / BLOCK_PX..((at + REACH_PX) / BLOCK_PX + 1).min(end);
        for (x, y) in sources {
            for row in reached(y, down) {
                reached(x, across).for_each(|column| order.whole_block(column, row));
            }
        }
        let rest = |order: &Self, column: usize, row: usize| !order.sent[row * across + column];
        for row in 0..down {
            for column in 0..across {
                if rest(&order, column, row) {
                    order.push(column * BLOCK_PX, row * BLOCK_PX, MEAN);
                }
            }
        }
        for level in (0..LEVELS).rev() {
            for y in (0..height).step_by(2 << level) {
                for x in (0..width).step_by(2 << level) {
                    if rest(&order, x / BLOCK_PX, y / BLOCK_PX) {
                        order.cell(x, y, level);
                    }
                }
            }
        }
        order
    }

    fn whole_block(&mut self, column: usize, row: usize) {
        if std::mem::replace(&mut self.sent[row * self.across + column], true) {
            return;
        }
        let (left, top) = (column * BLOCK_PX, row * BLOCK_PX);
        self.push(left, top, MEAN);
        for level in (0..LEVELS).rev() {
            for y in (top..self.height.min(top + BLOCK_PX)).step_by(2 << level) {
                for x in (left..self.width.min(left + BLOCK_PX)).step_by(2 << level) {
                    self.cell(x, y, level);
                }
            }
        }
    }

    /// The differences of a level (0 is the finest) around the mean at a place: along the row, along the column, along both.
    fn cell(&mut self, x: usize, y: usize, level: usize) {
        let step = 1 << level;
        let one_axis = 1 + 2 * level as u8;
        let (right, below) = (x + step < self.width, y + step < self.height);
        if right {
            self.push(x + step, y, one_axis);
        }
        if below {
            self.push(x, y + step, one_axis);
        }
        if right && below {
            self.push(x + step, y + step, one_axis + 1);
        }
    }

    fn push(&mut self, x: usize, y: usize, class: u8) {
        self.places.push((y * self.width + x) as u32);
        self.classes.push(class);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_inverse_gives_the_plane_again_and_the_order_has_each_place_once(
            width in 1usize..70,
            height in 1usize..70,
            seed in prop::collection::vec(any::<u16>(), 97),
            sources in prop::collection::vec((0usize..70, 0usize..70), 0..5),
        ) {
            let plane: Vec<i32> = (0..width * height).map(|i| i32::from(seed[i * i % 97])).collect();
            let mut coefficients = plane.clone();
            forward(&mut coefficients, width);
            let order = Order::new(width, height, sources.into_iter().map(|(x, y)| (x.min(width - 1), y.min(height - 1))));
            let mut seen = vec![false; plane.len()];
            for (&place, &class) in order.places.iter().zip(&order.classes) {
                prop_assert!(!std::mem::replace(&mut seen[place as usize], true));
                prop_assert!(class != MEAN || (0..=65_535).contains(&coefficients[place as usize]));
                prop_assert!(coefficients[place as usize].abs() <= 2 * 65_535);
            }
            prop_assert!(seen.iter().all(|&seen| seen));
            inverse(&mut coefficients, width);
            prop_assert_eq!(coefficients, plane);
        }
    }
}
