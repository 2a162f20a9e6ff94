//! Lines across the picture: peaks that a ridge runs through and that lie on one straight line are no stars, but a satellite's streak,
//! a hot column, a reflection's edge.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: indices run over the list of places itself")]

use crate::sky::{Kernel, with_vectors};

/// A place belongs to a line within this distance, samples.
const REACH: f32 = 3.0;
/// Places further apart than this span a line, samples: nearer ones say too little about its direction.
const LEAST_SPAN: f32 = 30.0;
/// Places on ridges that make a line: stars trailed alike are ridges too, but six of them are not in line by chance.
const LEAST_PLACES: usize = 6;
/// Trails in line with each other that make a streak, which is all trails along itself; and how far its direction may be from that of
/// the kernel, sine: those of kernels are up to 27° apart. (Of 60 places anywhere ten are on such a line in one frame of twenty.)
const LEAST_TRAILS: usize = 10;
const ASTRAY: f32 = 0.3;
/// Lines looked for, and places on ridges looked at: a line of many is found among the best.
const MOST_LINES: usize = 4;
const MOST_PLACES: usize = 60;
const ROOM: usize = MOST_PLACES.next_multiple_of(8);

/// A line, as the unit vector across it and the distance from the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    across: (f32, f32),
    distance: f32,
}

impl Line {
    /// The line through two places that are far enough apart.
    #[inline(always)]
    fn through(a: (f32, f32), b: (f32, f32)) -> Option<Self> {
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let length = (dx * dx + dy * dy).sqrt();
        (length >= LEAST_SPAN).then(|| {
            let across = (-dy / length, dx / length);
            Self { across, distance: a.0 * across.0 + a.1 * across.1 }
        })
    }

    /// Whether a place belongs to it.
    pub fn passes(&self, place: (f32, f32)) -> bool {
        (place.0 * self.across.0 + place.1 * self.across.1 - self.distance).abs() <= REACH
    }
}

/// The lines that hold most of the places on ridges, one after the other. `along`: where the places are of trails, the direction of these.
pub fn find(mut places: Vec<(f32, f32)>, along: Option<(f32, f32)>) -> Vec<Line> {
    let least = if along.is_some() { LEAST_TRAILS } else { LEAST_PLACES };
    let mut lines = Vec::new();
    places.truncate(MOST_PLACES);
    while lines.len() < MOST_LINES && places.len() >= least {
        let Some(line) = with_vectors(Fullest { places: &places, along, least }) else { break };
        places.retain(|p| !line.passes(*p));
        lines.push(line);
    }
    lines
}

/// The line through two of the places that holds most of them, and no fewer than `least`; of equals the first.
struct Fullest<'a> {
    places: &'a [(f32, f32)],
    along: Option<(f32, f32)>,
    least: usize,
}

impl Kernel for Fullest<'_> {
    type Output = Option<Line>;

    #[inline(always)]
    fn run(self) -> Option<Line> {
        let Self { places, along, least } = self;
        let along = along.map(|(x, y)| (x, y, ASTRAY * x.hypot(y)));
        let is_along = |line: &Line| along.is_none_or(|(x, y, most)| (x * line.across.0 + y * line.across.1).abs() <= most);
        // Room for as many as are looked at, so that all are counted in whole vectors; what is not filled lies on no line.
        let (mut x, mut y) = ([f32::INFINITY; ROOM], [0f32; ROOM]);
        for (n, place) in places.iter().enumerate().take(ROOM) {
            (x[n], y[n]) = *place;
        }
        let mut best: Option<(i32, Line)> = None;
        for (i, &a) in places.iter().enumerate() {
            for &b in &places[i + 1..] {
                let Some(line) = Line::through(a, b).filter(is_along) else { continue };
                // Without a check of overflow, which would keep it from being done in vectors.
                let mut count = 0i32;
                for n in 0..ROOM {
                    let is_on = (x[n] * line.across.0 + y[n] * line.across.1 - line.distance).abs() <= REACH;
                    count = count.wrapping_add(i32::from(is_on));
                }
                if count as usize >= least && best.is_none_or(|(most, _)| count > most) {
                    best = Some((count, line));
                }
            }
        }
        best.map(|(_, line)| line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn a_streak_among_scattered_places_is_found_and_nothing_else() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let mut places: Vec<(f32, f32)> =
            (0..30).map(|_| (1536.0 * random.random::<f32>(), 1024.0 * random.random::<f32>())).collect();
        assert_eq!(find(places.clone(), None), []);
        places.extend((0..12).map(|i| (100.0 + 90.0 * i as f32, 200.0 + 40.0 * i as f32 + random.random::<f32>())));
        let lines = find(places.clone(), None);
        assert_eq!(lines.len(), 1);
        assert!(lines[0].passes((100.0 + 45.0, 200.0 + 20.5)) && !lines[0].passes((145.0, 230.0)));
        assert_eq!(find(places.clone(), Some((2.0, 1.0))), lines);
        assert_eq!(find(places, Some((1.0, -2.0))), []);
    }

    #[test]
    fn neighbours_make_no_line() {
        assert_eq!(find((0..9).map(|i| (i as f32, 2.0 * i as f32)).collect(), None), []);
    }
}
