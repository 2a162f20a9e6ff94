//! Checksums of a header and its data: `DATASUM` and `CHECKSUM` (FITS 4.0, § 4.4.2.7 and appendix J).
//!
//! The sum is that of 32-bit big-endian words in ones' complement. `CHECKSUM` holds sixteen letters that make the sum of the
//! whole unit come to −0, in which all bits are set.

/// The value of `CHECKSUM` while the sum is taken.
pub(super) const UNSUMMED: &str = "0000000000000000";
/// What a unit whose checksum holds comes to.
const MINUS_ZERO: u32 = u32::MAX;

/// A sum in the making, of words that come as bytes or as pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Sum {
    /// High and low halves of the words, each in its own sum, which cannot overflow in 2⁴⁸ words.
    halves: [u64; 2],
}

impl Sum {
    /// Adds whole 32-bit words; bytes past the last whole word count as zeros.
    pub fn add_bytes(&mut self, bytes: &[u8]) {
        let (words, rest) = bytes.as_chunks::<4>();
        let mut last = [0; 4];
        last.iter_mut().zip(rest).for_each(|(byte, rest)| *byte = *rest);
        for [a, b, c, d] in words.iter().copied().chain([last]) {
            self.halves[0] += u64::from(u16::from_be_bytes([a, b]));
            self.halves[1] += u64::from(u16::from_be_bytes([c, d]));
        }
    }

    /// Adds 16-bit values that stand one after the other; `odd`: the first of them is the second half of a word.
    pub fn add_values(&mut self, values: impl Iterator<Item = u16>, mut odd: bool) {
        let [high, low] = self.halves;
        let (mut here, mut other) = if odd { (low, high) } else { (high, low) };
        for value in values {
            here += u64::from(value);
            std::mem::swap(&mut here, &mut other);
            odd = !odd;
        }
        self.halves = if odd { [other, here] } else { [here, other] };
    }

    /// The sum, its carries brought round.
    pub fn value(self) -> u32 {
        let [high, low] = self.halves;
        let mut sum = (u128::from(high) << 16) + u128::from(low);
        while sum > u128::from(u32::MAX) {
            sum = (sum & u128::from(u32::MAX)) + (sum >> 32);
        }
        sum as u32
    }
}

/// The letters that bring a sum to −0 where they stand, quoted, in columns 12 to 27 of a card.
pub(super) fn letters(sum: u32) -> String {
    let mut columns = [[0_u8; 4]; 4];
    for (byte, letters) in (!sum).to_be_bytes().into_iter().zip(&mut columns) {
        *letters = [byte / 4 + b'0'; 4];
        letters[0] += byte % 4;
        // Only digits and letters may stand there: what one of a pair gives the other takes.
        while letters.iter().any(|letter| !letter.is_ascii_alphanumeric()) {
            let (pairs, _) = letters.as_chunks_mut::<2>();
            for [first, second] in pairs.iter_mut().filter(|pair| !pair.iter().all(u8::is_ascii_alphanumeric)) {
                *first += 1;
                *second -= 1;
            }
        }
    }
    let mut letters: Vec<u8> = (0..4).flat_map(|row| columns.iter().filter_map(move |column| column.get(row).copied())).collect();
    // The first letter stands in the last byte of a word.
    letters.rotate_right(1);
    letters.into_iter().map(char::from).collect()
}

/// Whether the sums of a file of one header and data hold.
pub(super) fn hold(bytes: &[u8]) -> bool {
    let mut sum = Sum::default();
    sum.add_bytes(bytes);
    sum.value() == MINUS_ZERO
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_letters_are_those_of_the_standard_and_bring_any_sum_to_minus_zero() {
        // FITS 4.0, appendix J.4: the complement of 868229149 is 3426738146.
        assert_eq!(letters(868_229_149), "hcHjjc9ghcEghc9g");
        for sum in [0, 1, u32::MAX, 0x3a40_5b60, 0x0102_0304, 0xfedc_ba98, 123_456_789] {
            let card = format!("CHECKSUM= '{}'", letters(sum));
            let (mut with, mut without) = (Sum::default(), Sum::default());
            with.add_bytes(card.as_bytes());
            without.add_bytes(format!("CHECKSUM= '{UNSUMMED}'").as_bytes());
            assert!(card.bytes().skip(11).take(16).all(|letter| letter.is_ascii_alphanumeric()), "{card}");
            // The rest of the unit has what is missing between the card without its sum and the sum.
            let rest = (u64::from(sum) + u64::from(u32::MAX) - u64::from(without.value())) % u64::from(u32::MAX);
            let total = (rest + u64::from(with.value())) % u64::from(u32::MAX);
            assert_eq!(total, 0, "{sum}");
        }
    }

    #[test]
    fn pixels_and_their_bytes_have_one_sum() {
        let values: Vec<u16> = (0..1001_u32).map(|i| (i * 7919 % 65_536) as u16).collect();
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
        let (mut of_bytes, mut of_values) = (Sum::default(), Sum::default());
        of_bytes.add_bytes(&bytes);
        let mut at = 0;
        for row in values.chunks(13) {
            of_values.add_values(row.iter().copied(), at % 2 == 1);
            at += row.len();
        }
        assert_eq!(of_bytes.value(), of_values.value());
    }
}
