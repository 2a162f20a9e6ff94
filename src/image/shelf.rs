//! The shelf: which of the images that are kept go when there is no room for more.
//!
//! What stays is spread over the whole flight: of the images of one rank the oldest goes first, and the rank of an image is how often
//! two divides its number. So every second image goes first, then every second one of the others, and so on; the newest are spared,
//! whatever their number.

use super::ImageCounter;
use std::collections::VecDeque;

/// Ranks; an image whose number two divides more often, and number 0, is of the last.
const RANKS: usize = 16;
/// The newest images are spared: what operators still ask for.
const SPARED: u64 = 64;

/// An image that is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shelved<T> {
    /// What it is found by.
    pub name: T,
    /// What it takes, bytes.
    pub bytes: u64,
    /// Its place in the order in which images came.
    place: u64,
}

/// All images that are kept.
#[derive(Debug, Clone)]
pub struct Shelf<T> {
    ranks: [VecDeque<Shelved<T>>; RANKS],
    bytes: u64,
    next: u64,
}

impl<T> Default for Shelf<T> {
    fn default() -> Self {
        Self { ranks: Default::default(), bytes: 0, next: 0 }
    }
}

impl<T> Shelf<T> {
    /// An image is kept, the newest of all.
    pub fn put(&mut self, image: ImageCounter, name: T, bytes: u64) {
        let rank = image.0.trailing_zeros() as usize;
        if let Some(rank) = self.ranks.get_mut(rank.min(RANKS - 1)) {
            rank.push_back(Shelved { name, bytes, place: self.next });
            self.bytes = self.bytes.saturating_add(bytes);
            self.next += 1;
        }
    }

    /// Takes the image that goes next; `None` where none is left.
    pub fn take(&mut self) -> Option<Shelved<T>> {
        let spared = self.next.saturating_sub(SPARED);
        let of_age = |rank: &VecDeque<Shelved<T>>| rank.front().is_some_and(|image| image.place < spared);
        let rank = match self.ranks.iter().position(of_age) {
            Some(rank) => self.ranks.get_mut(rank),
            // The newest alone are more than there is room for: the oldest of them.
            None => {
                self.ranks.iter_mut().filter(|rank| !rank.is_empty()).min_by_key(|rank| rank.front().map(|image| image.place))
            }
        };
        let gone = rank?.pop_front()?;
        self.bytes = self.bytes.saturating_sub(gone.bytes);
        Some(gone)
    }

    /// What all of them take, bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.ranks.iter().map(VecDeque::len).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_is_spread_over_the_whole_flight_and_the_newest_are_all_there() {
        let (mut shelf, room) = (Shelf::default(), 1000);
        for image in 0..20_000_u32 {
            shelf.put(ImageCounter(image), image, 3);
            while shelf.bytes() > 3 * room {
                shelf.take().unwrap();
            }
        }
        let mut left: Vec<u32> = std::iter::from_fn(|| shelf.take()).map(|image| image.name).collect();
        assert_eq!((left.len(), shelf.bytes(), shelf.is_empty()), (1000, 0, true));
        left.sort_unstable();
        assert!((20_000 - SPARED as u32..20_000).all(|image| left.binary_search(&image).is_ok()), "the newest are there");
        let widest = left.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
        assert_eq!((left[0], widest), (0, 32), "one of 32 at least, over all of the flight");
    }

    #[test]
    fn where_even_the_newest_have_no_room_the_oldest_of_them_goes() {
        let mut shelf = Shelf::default();
        (0..10).for_each(|image| shelf.put(ImageCounter(image), image, 1));
        assert_eq!(shelf.take().map(|image| image.name), Some(0));
        assert_eq!(shelf.take().map(|image| image.name), Some(1));
    }
}
