//! One frame with all that is shown of it, in the picture's own coordinates: x right, y down from the top row, px.

use super::lamps::{Lamp, lamps};
use super::mask::Proposal;
use crate::image::Mask;
use crate::settings::{MaskSettings, Settings};
use crate::sky::{ARCSEC, CameraModel, RowOrder, Vec3};
use crate::solve::{Outcome, Report, Solution};
use serde::Serialize;

/// The size of a frame, and which way it is up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Geometry {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Whether the first row of the file is the top one.
    pub top_first: bool,
    /// Whether the optics turn the picture over.
    pub mirrored: bool,
}

impl Geometry {
    /// Of a size, px, and an order of rows.
    pub fn new(width: usize, height: usize, rows: RowOrder, mirrored: bool) -> Self {
        Self { width, height, top_first: rows == RowOrder::TopFirst, mirrored }
    }

    fn rows(&self) -> RowOrder {
        if self.top_first { RowOrder::TopFirst } else { RowOrder::BottomFirst }
    }

    /// The row of the picture that a row of the file is.
    fn down(&self, y: f64) -> f64 {
        if self.top_first { y } else { self.height as f64 - 1.0 - y }
    }
}

/// What became of a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fate {
    /// It is the brightest that is a star.
    Brightest,
    /// It is a star.
    Matched,
    /// It would be a star of the candidate that was refused.
    Candidate,
    /// No star is there.
    Unmatched,
    /// No pattern was made of it.
    Untried,
}

/// A source as it is shown. A number that is not finite is null.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceFate {
    /// Column of the picture, px.
    pub x: f64,
    /// Row of the picture, from the top, px.
    pub y: f64,
    /// What became of it.
    pub fate: Fate,
    /// The star's name, where it is one.
    pub name: Option<String>,
    /// From the source to its star, right and down, px.
    pub residual_px: Option<[f64; 2]>,
    /// The same in words, with the reason where it was rejected.
    pub words: String,
}

/// The mask in force, as blocks of the picture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MaskView {
    /// Whether it is applied.
    pub enabled: bool,
    /// Side of a block, px.
    pub block_px: usize,
    /// Whole blocks in a row.
    pub columns: usize,
    /// Rows of whole blocks.
    pub rows: usize,
    /// The words of the settings.
    pub fields: Vec<u32>,
    /// Masked blocks: column, and row from the bottom.
    pub masked: Vec<[usize; 2]>,
    /// Why it does not fit this frame, where it doesn't.
    pub problem: Option<String>,
}

/// One frame with all that is shown of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrameView {
    /// Its outcome.
    pub report: Report,
    /// Whether its pixels can still be had.
    pub pixels: bool,
    /// Its size, where it was looked at.
    pub geometry: Option<Geometry>,
    /// Its sources, brightest first, as the report has them.
    pub sources: Vec<SourceFate>,
    /// Where North and East are: steps of one px in the picture.
    pub compass: Option<[[f64; 2]; 2]>,
    /// The requirements, with value and limit.
    pub lamps: Vec<Lamp>,
    /// The mask in force.
    pub mask: Option<MaskView>,
    /// A mask that the service proposes.
    pub proposal: Option<Proposal>,
}

impl FrameView {
    /// A frame under the settings in force.
    pub fn new(outcome: &Outcome, report: &Report, geometry: Option<Geometry>, settings: &Settings) -> Self {
        let fates = geometry.map(|geometry| fates(outcome, report, &geometry)).unwrap_or_default();
        let shown = outcome.solution.as_ref().or(outcome.candidate.as_ref());
        Self {
            report: report.clone(),
            pixels: geometry.is_some(),
            geometry,
            sources: fates,
            compass: geometry.zip(outcome.solution.as_ref()).and_then(|(geometry, solution)| compass(&geometry, solution)),
            lamps: lamps(shown, &outcome.prior, settings),
            mask: geometry.map(|geometry| MaskView::new(&settings.solver.mask, &geometry)),
            proposal: None,
        }
    }
}

impl MaskView {
    /// The mask of the settings over a frame.
    pub fn new(settings: &MaskSettings, geometry: &Geometry) -> Self {
        let block_px = usize::try_from(settings.block_px).unwrap_or(usize::MAX).max(1);
        let (columns, rows) = (geometry.width / block_px, geometry.height / block_px);
        // Asked of the solver's own mask, so that what is shaded is what is left out.
        let mask = Mask::new(settings, geometry.width, geometry.height, RowOrder::BottomFirst);
        let (masked, problem) = match mask {
            Ok(mask) => {
                let blocks = (0..rows).flat_map(|row| (0..columns).map(move |column| [column, row]));
                (blocks.filter(|[column, row]| mask.is_masked(column * block_px, row * block_px)).collect(), None)
            }
            Err(error) => (Vec::new(), Some(error.to_string())),
        };
        Self { enabled: settings.enabled, block_px, columns, rows, fields: settings.fields.clone(), masked, problem }
    }
}

fn fates(outcome: &Outcome, report: &Report, geometry: &Geometry) -> Vec<SourceFate> {
    let solution = outcome.solution.as_ref();
    let pair = |of: Option<&Solution>, id: usize| of.and_then(|of| of.matches.iter().find(|pair| pair.source == id).copied());
    let brightest = solution.and_then(|solution| solution.matches.iter().map(|pair| pair.source).min());
    let fate_of = |(id, source): (usize, &crate::solve::SourceReport)| {
        let entry = report.sources.get(id);
        let star = entry.and_then(|entry| entry.star.as_ref());
        let matched = pair(solution, id);
        let in_candidate = pair(outcome.candidate.as_ref(), id).is_some();
        let fate = match (matched.is_some(), in_candidate) {
            (true, _) if brightest == Some(id) => Fate::Brightest,
            (true, _) => Fate::Matched,
            (false, true) => Fate::Candidate,
            (false, false) if solution.is_none() && id >= outcome.sources_tried => Fate::Untried,
            (false, false) => Fate::Unmatched,
        };
        let down = if geometry.top_first { 1.0 } else { -1.0 };
        SourceFate {
            x: source.x,
            y: geometry.down(source.y),
            fate,
            name: star.map(|star| star.name.clone()),
            residual_px: matched.map(|pair| [pair.residual_px.0, down * pair.residual_px.1]),
            words: words(outcome, fate, source.saturated, star.map(|star| star.name.as_str())),
        }
    };
    outcome.sources.iter().enumerate().map(fate_of).collect()
}

/// What became of a source, for people.
fn words(outcome: &Outcome, fate: Fate, saturated: bool, star: Option<&str>) -> String {
    let why = match fate {
        Fate::Brightest | Fate::Matched => format!("is {}", star.unwrap_or("a star")),
        Fate::Candidate => format!("would be a star of the candidate, which was refused: {}", outcome.detail),
        Fate::Unmatched if outcome.solution.is_some() => "no star of the catalogue is here".to_owned(),
        Fate::Unmatched if outcome.candidate.is_some() => "no star of the refused candidate is here".to_owned(),
        Fate::Unmatched => format!("fits no pattern of stars: {}", outcome.detail),
        Fate::Untried => format!("not tried: {} brighter ones were", outcome.sources_tried),
    };
    if saturated { format!("{why}; saturated") } else { why }
}

/// Steps of one px towards North and East.
fn compass(geometry: &Geometry, solution: &Solution) -> Option<[[f64; 2]; 2]> {
    let camera = CameraModel {
        width: geometry.width,
        height: geometry.height,
        platescale: ARCSEC,
        k1: 0.0,
        rows: geometry.rows(),
        mirrored: geometry.mirrored,
    };
    let boresight = solution.attitude.boresight();
    let east = Vec3::z().cross(&boresight);
    let step = |towards: Vec3| {
        let seen = solution.attitude.to_camera(&towards);
        let length = seen.x.hypot(seen.y);
        (length > 0.0).then(|| {
            let (x, y) = camera.position(seen.x / length, seen.y / length);
            let (x0, y0) = camera.position(0.0, 0.0);
            [x - x0, geometry.down(y) - geometry.down(y0)]
        })
    };
    Some([step(boresight.cross(&east))?, step(east)?])
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::image::Stamp;
    use crate::sky::{Attitude, DEG, Mat3};
    use crate::solve::{Match, Reason, SourceReport, StarEntry, Statistics};

    /// A frame of three sources, of which the second is a star where it is solved, and of the candidate where it is refused.
    pub fn outcome(reason: Reason) -> (Outcome, Report) {
        let source = |x, y| SourceReport { x, y, sigma_px: 0.1, flux: 1.0, snr: 9.0, peak: 1.0, saturated: false };
        let solution = Solution {
            attitude: Attitude::from_angles(1.0, 0.5, 0.0),
            platescale: 9.5 * ARCSEC,
            k1: 0.0,
            axis: (0.0, 0.0),
            covariance: Mat3::identity() * ARCSEC * ARCSEC,
            sigma_platescale: 0.0,
            rms_px: 0.1,
            chi2_per_dof: 1.0,
            matches: vec![Match { source: 1, star: 0, residual_px: (0.5, 0.25) }],
            false_probability_log10: -9.0,
            horizontal: None,
            epoch_yr: None,
            start: None,
            served: None,
        };
        let solved = reason == Reason::Solved;
        let outcome = Outcome {
            sources: vec![source(150.0, 60.0), source(50.0, 30.0), source(20.0, 20.0)],
            sources_tried: 2,
            triangles: vec![[0, 1, 2]],
            solution: solved.then(|| solution.clone()),
            candidate: (reason == Reason::Requirement).then_some(solution),
            statistics: Some(Statistics { level: (100, 300), ..Statistics::default() }),
            ..Outcome::unsolved(Stamp::default(), reason, "elevation: 70° is outside 0° to 60°")
        };
        let mut report = Report::without_stars(&outcome);
        if solved {
            let star = StarEntry {
                id: 0,
                name: "Vega".to_owned(),
                ra_deg: Some(1.0 / DEG),
                dec_deg: Some(0.5 / DEG),
                mag: Some(0.0),
                residual_px: Some(0.5),
            };
            report.sources.iter_mut().skip(1).take(1).for_each(|source| source.star = Some(star.clone()));
        }
        (outcome, report)
    }

    /// The view of such a frame of 200 × 100 px.
    pub fn view(reason: Reason, rows: RowOrder, mirrored: bool) -> FrameView {
        let (outcome, report) = outcome(reason);
        FrameView::new(&outcome, &report, Some(Geometry::new(200, 100, rows, mirrored)), &Settings::flight().unwrap())
    }

    #[test]
    fn every_source_says_where_it_is_seen_and_what_became_of_it() {
        let solved = view(Reason::Solved, RowOrder::BottomFirst, false);
        let star = &solved.sources[1];
        assert_eq!((star.fate, star.y, star.residual_px), (Fate::Brightest, 99.0 - 30.0, Some([0.5, -0.25])));
        assert_eq!((star.name.as_deref(), star.words.as_str()), (Some("Vega"), "is Vega"));
        assert_eq!(solved.sources[0].words, "no star of the catalogue is here");
        let refused = view(Reason::Requirement, RowOrder::TopFirst, false);
        let fates: Vec<Fate> = refused.sources.iter().map(|source| source.fate).collect();
        assert_eq!(fates, [Fate::Unmatched, Fate::Candidate, Fate::Untried]);
        assert!(refused.sources[1].words.ends_with("elevation: 70° is outside 0° to 60°"), "{}", refused.sources[1].words);
        assert_eq!((refused.sources[1].y, refused.sources[2].words.as_str()), (30.0, "not tried: 2 brighter ones were"));
        let unmatched = view(Reason::NoMatch, RowOrder::TopFirst, false);
        assert!(unmatched.sources[0].words.starts_with("fits no pattern of stars"));
    }

    #[test]
    fn the_compass_turns_over_behind_a_mirror_and_with_nothing_else() {
        // At roll 0 North is up; East is to the left of it seen from below.
        for (rows, mirrored, east) in
            [(RowOrder::TopFirst, false, -1.0), (RowOrder::BottomFirst, false, -1.0), (RowOrder::TopFirst, true, 1.0)]
        {
            let [north, seen] = view(Reason::Solved, rows, mirrored).compass.unwrap();
            assert!(north[1] < -0.99 && (seen[0] - east).abs() < 1e-6, "{rows:?} {mirrored}: {north:?} {seen:?}");
        }
    }

    #[test]
    fn the_mask_that_is_shaded_is_the_one_that_the_solver_leaves_out() {
        let geometry = Geometry::new(1536, 1024, RowOrder::TopFirst, false);
        let settings = |fields: &[u32]| MaskSettings { enabled: true, block_px: 128, fields: fields.to_vec() };
        let mask = MaskView::new(&settings(&[1 << 13]), &geometry);
        assert_eq!((mask.columns, mask.rows, mask.masked), (12, 8, vec![[1, 1]]));
        let unfit = MaskView::new(&settings(&[0, 0, 0, 1]), &geometry);
        assert!(unfit.masked.is_empty() && unfit.problem.unwrap().contains("solver.mask.fields"));
    }

    #[test]
    fn a_frame_that_was_never_looked_at_has_its_outcome_and_no_more() {
        let outcome = Outcome::unsolved(Stamp::default(), Reason::Unreadable, "no image");
        let view = FrameView::new(&outcome, &Report::without_stars(&outcome), None, &Settings::flight().unwrap());
        assert!(view.sources.is_empty() && view.mask.is_none() && view.compass.is_none());
        assert!(!serde_json::to_string(&view).unwrap().contains("NaN"));
    }
}
