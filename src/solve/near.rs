//! The search near a prior: pairs of sources against pairs of the stars that the prior expects in the picture.
//!
//! A prior leaves little to search, so that a pattern of three stars may be beyond what chance explains. Nothing here believes it: the
//! bound is that on a chance match among the attitudes looked at, wherever the camera really looks, so that a wrong prior finds nothing
//! here, and the frame is searched lost in space.

use super::Stop;
use super::fit::Pose;
use super::pattern::{SearchEnd, SearchTally};
use super::track::Region;
use super::verify::{FrameGeometry, Hypothesis, PatternSource, SHARPEST_PX, verify_from};
use crate::catalog::Field;
use crate::sky::{Attitude, Vec3};

/// Stars near the prior, at most: beyond it the search of the whole sky is as good.
const MOST_STARS: usize = 256;
/// Sources nearer to each other do not tell the roll, px.
const LEAST_PAIR_PX: f64 = 100.0;
/// Error of a place in a pair, px: as of a triangle's corner.
const PAIR_TOLERANCE_PX: f64 = 2.5;
/// Pairs of stars that may be compared: one or two milliseconds.
const PAIR_BUDGET: u64 = 1_000_000;
/// Range of the magnitudes at which the stars may turn out to be seen, and the scatter about that, mag: as verification has them.
const ZERO_POINTS: f64 = 4.0 / 0.65;
/// Searches of the same frame: of its sure sources, of all, and lost in space.
const SEARCHES: f64 = 3.0;
/// Distance in σ of one hypothesis from the next: √(2π), in which a Gaussian peak is as wide as a box of its height.
const PEAK_WIDTH: f64 = 2.5;

/// A place in the plane that touches the sky at the prior's boresight, px along left and up.
type Place = (f64, f64);

/// Square of a place's distance from the middle, px². Comparing squares spares the search most of its time.
fn square((left, up): Place) -> f64 {
    left * left + up * up
}

/// What the search is bound by.
pub struct NearRules<'a> {
    /// Fewest matches of a solution.
    pub min_matched: usize,
    /// Greatest ln probability that a solution is false.
    pub max_false_ln: f64,
    /// Asked after each pair of sources.
    pub stop: &'a dyn Fn() -> Option<Stop>,
}

/// A search over one list of sources.
pub struct NearSearch<'a> {
    field: &'a Field,
    sources: &'a [PatternSource],
    geometry: &'a FrameGeometry,
    region: &'a Region,
    rules: &'a NearRules<'a>,
    /// The sources without the known distortion.
    places: Vec<Place>,
    /// The stars that may be in the picture: where the prior expects them, and their directions.
    stars: Vec<(Place, Vec3)>,
    tally: SearchTally,
    best: Option<Hypothesis>,
}

impl<'a> NearSearch<'a> {
    /// A search for `sources`, brightest first, near a prior; `None` where that leaves too much of the sky, or there are too few sources.
    pub fn new(
        field: &'a Field,
        sources: &'a [PatternSource],
        geometry: &'a FrameGeometry,
        region: &'a Region,
        rules: &'a NearRules<'a>,
    ) -> Option<Self> {
        let scale = geometry.prior.platescale;
        let (middle, half_field) = (region.attitude.boresight(), (geometry.half_diagonal * scale).atan());
        let reach = half_field + region.boresight.reach();
        /// Further out the plane stretches too much.
        const WIDEST: f64 = 0.6;
        if sources.len() < rules.min_matched.max(2) || !(reach < WIDEST) {
            return None;
        }
        let mut stars = Vec::new();
        field.stars.near(&middle, reach, |_, star| {
            if star.rank < field.verification_rank {
                let c = region.attitude.to_camera(&star.direction);
                stars.push(((c.x / c.z / scale, c.y / c.z / scale), star.direction));
            }
        });
        if stars.len() > MOST_STARS {
            return None;
        }
        let half_sq = geometry.half_diagonal * geometry.half_diagonal;
        let places = sources.iter().map(|source| {
            let stretch = 1.0 + geometry.prior.k1 * (source.left * source.left + source.up * source.up) / half_sq;
            (source.left / stretch, source.up / stretch)
        });
        let places = places.collect();
        Some(Self { field, sources, geometry, region, rules, places, stars, tally: SearchTally::default(), best: None })
    }

    /// Runs the search to its end.
    pub fn run(mut self) -> (SearchEnd, SearchTally) {
        let end = self.pairs().unwrap_or_else(|| SearchEnd::Exhausted(self.best.take()));
        (end, self.tally)
    }

    /// Every pair of sources, by the fainter of the two.
    fn pairs(&mut self) -> Option<SearchEnd> {
        let places = self.places.clone();
        let mut compared = 0;
        for (j, &second) in places.iter().enumerate() {
            for &first in places.get(..j).unwrap_or_default() {
                if let Some(stop) = (self.rules.stop)() {
                    return Some(SearchEnd::Stopped(stop));
                }
                for (pose, spare) in self.candidates(first, second, &mut compared) {
                    self.tally.candidates += 1;
                    if spare + 2 >= self.rules.min_matched
                        && let Some(found) = self.look_at(&pose)
                    {
                        return Some(SearchEnd::Found(found));
                    }
                }
                if compared > PAIR_BUDGET {
                    return Some(SearchEnd::Budget(self.best.take()));
                }
            }
        }
        None
    }

    /// The poses of the region that put two sources on stars, each with the number of other sources that are then on one.
    fn candidates(&self, first: Place, second: Place, compared: &mut u64) -> Vec<(Pose, usize)> {
        let along = (second.0 - first.0, second.1 - first.1);
        let length = along.0.hypot(along.1);
        if length < LEAST_PAIR_PX {
            return Vec::new();
        }
        let scale = self.geometry.prior.platescale;
        let (low, high) = self.geometry.platescale_range;
        let shift = self.region.boresight.reach() / scale;
        let roll = self.region.roll.reach();
        // What the plane stretches between the prior's boresight and the true one: the shift times the square of the field's radius.
        let bend = (shift * scale + self.geometry.half_diagonal * scale).powi(2) * shift;
        let slack = PAIR_TOLERANCE_PX + bend;
        let wider = (high / scale - 1.0).max(1.0 - low / scale);
        // How far from where the prior expects it a source may be.
        let reach_of = |place: Place| {
            let from_centre = place.0.hypot(place.1);
            shift + slack + from_centre * (wider + 2.0 * (0.5 * roll).sin())
        };
        let near = |place: Place| {
            let reach_sq = reach_of(place).powi(2);
            self.stars.iter().filter(move |((left, up), _)| square((left - place.0, up - place.1)) <= reach_sq)
        };
        let seconds: Vec<&(Place, Vec3)> = near(second).collect();
        let (shortest, longest) = (length * low / scale - slack, length * high / scale + slack);
        let (shortest_sq, longest_sq) = (shortest.max(0.0).powi(2), longest.powi(2));
        let mut poses = Vec::new();
        for a in near(first) {
            *compared += seconds.len() as u64;
            for b in &seconds {
                let between = (b.0.0 - a.0.0, b.0.1 - a.0.1);
                if !(shortest_sq..=longest_sq).contains(&square(between)) {
                    continue;
                }
                // The turn and stretch that take one pair to the other, as a complex number.
                let turn = (
                    (along.0 * between.0 + along.1 * between.1) / (length * length),
                    (along.0 * between.1 - along.1 * between.0) / (length * length),
                );
                let centre = (a.0.0 - (turn.0 * first.0 - turn.1 * first.1), a.0.1 - (turn.0 * first.1 + turn.1 * first.0));
                let turned = turn.1.atan2(turn.0).abs();
                if turned > roll + 2.0 * slack / length || square(centre) > (shift + slack * (1.0 + turned)).powi(2) {
                    continue;
                }
                if let Some(attitude) = self.attitude_of((first, second), (&a.1, &b.1)) {
                    let pose = Pose { k1: self.geometry.prior.k1, ..Pose::undistorted(attitude, scale) };
                    poses.push((pose, self.others(centre, turn, (first, second), slack)));
                }
            }
        }
        poses
    }

    /// Sources besides a pair's own that are on a star where the plane is turned, stretched and shifted.
    fn others(&self, centre: Place, turn: Place, pair: (Place, Place), slack: f64) -> usize {
        let tolerance_sq = (self.geometry.tolerance + slack).powi(2);
        let on_a_star = |place: &&Place| {
            let left = centre.0 + turn.0 * place.0 - turn.1 * place.1;
            let up = centre.1 + turn.0 * place.1 + turn.1 * place.0;
            self.stars.iter().any(|((l, u), _)| (l - left) * (l - left) + (u - up) * (u - up) <= tolerance_sq)
        };
        self.places.iter().filter(|&&place| place != pair.0 && place != pair.1).filter(on_a_star).count()
    }

    /// The attitude that puts two places of the picture on two stars, the middle between them exactly.
    fn attitude_of(&self, (p, q): (Place, Place), (a, b): (&Vec3, &Vec3)) -> Option<Attitude> {
        let scale = self.geometry.prior.platescale;
        let in_camera = |place: Place| Vec3::new(place.0 * scale, place.1 * scale, 1.0).normalize();
        let frame = |a: &Vec3, b: &Vec3| Attitude::from_boresight_up(&(a + b), &(b - a));
        let (camera, sky) = (frame(&in_camera(p), &in_camera(q))?, frame(a, b)?);
        let on_sky = |v: &Vec3| sky.to_sky(&camera.to_camera(v));
        Attitude::from_boresight_up(&on_sky(&Vec3::z()), &on_sky(&Vec3::y()))
    }

    /// Verifies a pose; gives the hypothesis where chance does not explain it.
    fn look_at(&mut self, pose: &Pose) -> Option<Hypothesis> {
        self.tally.verified += 1;
        let least = self.rules.min_matched;
        let mut hypothesis = verify_from(self.sources, pose, self.field, self.geometry, least, least)?;
        hypothesis.false_ln = self.ln_hypotheses(&hypothesis.pose)? - hypothesis.log_odds;
        if hypothesis.false_ln <= self.rules.max_false_ln {
            return Some(hypothesis);
        }
        if self.best.as_ref().is_none_or(|best| hypothesis.false_ln < best.false_ln) {
            self.best = Some(hypothesis);
        }
        None
    }

    /// ln of the number of hypotheses among which one at a pose is counted; `None` outside the region.
    ///
    /// Positions, rolls, plate scales and zero points of the magnitudes that could be told apart, as many as there would be if the whole
    /// region were as dense as it is here; so that the sum over all hypotheses of e^−ln is one, which is what Markov's bound needs. A
    /// likelihood is taken to be as sharp as it can be: with few matches the fit takes up much of the residuals. And all that as often
    /// as a frame's sources are searched.
    fn ln_hypotheses(&self, pose: &Pose) -> Option<f64> {
        let (off, turned) = self.region.distance(&pose.attitude);
        let geometry = self.geometry;
        let n = self.sources.len() as f64;
        let information: f64 = self.sources.iter().map(|s| 1.0 / (s.sigma * s.sigma + SHARPEST_PX * SHARPEST_PX)).sum();
        let sharpest = (n / information).sqrt();
        // One σ of the boresight and of the roll, rad; that of ln plate scale is as the roll's. Root mean square distance from the
        // centre of a uniform rectangle.
        let sigma = sharpest * pose.platescale / n.sqrt();
        let lever = geometry.size.0.hypot(geometry.size.1) / 12f64.sqrt();
        let sigma_roll = sharpest / (lever * n.sqrt());
        let edge = REGION_EDGE_PX * pose.platescale;
        if off > self.region.boresight.reach() + edge || turned > self.region.roll.reach() + REGION_EDGE_PX / lever {
            return None;
        }
        let (low, high) = geometry.platescale_range;
        let positions = self.region.boresight.area_at(off) / (std::f64::consts::TAU * sigma * sigma);
        let rolls = self.region.roll.width_at(turned) / (PEAK_WIDTH * sigma_roll);
        let scales = (high - low) / geometry.prior.platescale / (PEAK_WIDTH * sigma_roll);
        let zero_points = ZERO_POINTS * n.sqrt() / PEAK_WIDTH;
        Some([positions, rolls, scales, zero_points].iter().map(|count| count.max(1.0).ln()).sum::<f64>() + SEARCHES.ln())
    }
}

/// A fit may take a pose that was looked for inside the region this far out of it, px.
const REGION_EDGE_PX: f64 = 3.0;
