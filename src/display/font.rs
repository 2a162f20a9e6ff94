//! Letters for overlays: five by seven pixels each, drawn by hand in `font.txt`, so that no font is parsed on the flight computer.

/// Columns of a letter, px.
pub const WIDTH: usize = 5;
/// Rows of a letter, px.
pub const HEIGHT: usize = 7;
/// Columns from one letter to the next, px.
pub const ADVANCE: usize = WIDTH + 1;

/// The sheet: blocks of a line that names the letters, and seven rows with those letters side by side.
const SHEET: &str = include_str!("font.txt");

/// The lit pixels of a letter, as column and row from its upper left corner. A letter that the sheet does not have is an empty box.
pub fn pixels(letter: char) -> Vec<(usize, usize)> {
    let lines: Vec<&str> = SHEET.lines().collect();
    let drawn = lines.chunks(HEIGHT + 1).find_map(|block| {
        let (names, rows) = block.split_first()?;
        let place = names.chars().position(|name| name == letter)?;
        Some(rows.iter().map(|row| row.chars().skip(place * ADVANCE).take(WIDTH).collect()).collect())
    });
    let rows: Vec<String> = match drawn {
        Some(rows) => rows,
        None if letter == ' ' => Vec::new(),
        None => vec![".....", ".###.", ".#.#.", ".#.#.", ".#.#.", ".###.", "....."].into_iter().map(str::to_owned).collect(),
    };
    let lit = |(y, row): (usize, &String)| -> Vec<(usize, usize)> {
        row.chars().enumerate().filter(|(_, sign)| *sign == '#').map(|(x, _)| (x, y)).collect()
    };
    rows.iter().enumerate().flat_map(lit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_letter_that_captions_use_is_drawn_and_unlike_the_others() {
        let letters: Vec<char> = ('!'..='~').filter(|c| !"$@\\^`{}~".contains(*c)).chain("°±σ″′".chars()).collect();
        let missing = pixels('\u{1F31F}');
        let mut seen = HashSet::from([missing]);
        for letter in letters {
            let lit = pixels(letter);
            assert!(lit.iter().all(|&(x, y)| x < WIDTH && y < HEIGHT), "{letter}");
            assert!(!lit.is_empty() && seen.insert(lit), "{letter} is not drawn, or looks like another");
        }
        assert!(pixels(' ').is_empty());
    }
}
