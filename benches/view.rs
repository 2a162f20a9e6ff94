//! Frames over a thin link that loses packets: `cargo bench --bench view -- --frames 20 --loss 0.3`.
//!
//! Rendered frames of kind float. Each is encoded with the sources that the solver found, sent over a simulated link with requests for what
//! is missing, and looked at twice: when the packets of the first 2 kB are there, and in the end. A line a frame; times are the
//! thread's own. A solution from the list of sources is right where centre and corners are within 30 px of the truth's, as in the bench
//! of lists. Beside it the sizes that the same pixels have in deflate and in Rice codes of differences.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use shared::{CpuWatch, quantile, timed};
use stars::catalog::{Catalogue, Field, FieldKey};
use stars::image::Frame;
use stars::image::view::{Assembly, MOST_PIXELS, PACKET_BYTES, View, ViewSource};
use stars::settings::Settings;
use stars::simulate::ThinLink;
use stars::simulate::sky::{Kind, RenderSpec, Truth, render};
use stars::sky::{CameraModel, Vec3};
use stars::solve::{FrameGeometry, PatternSearch, PatternSource, Pose, Prior, SearchEnd, SearchRules, Solver};
use std::f64::consts::LN_10;
use std::sync::Arc;

/// Measures the thin-link view
#[derive(Debug, Parser)]
struct Args {
    /// Frames
    #[arg(long, default_value_t = 20)]
    frames: u64,
    /// Kind of frame
    #[arg(long, default_value = "float")]
    kind: Kind,
    /// Seed of the frames and of the link
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Part of packets and requests that is lost
    #[arg(long, default_value_t = 0.3)]
    loss: f64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// Sources that are looked for among those that came, and how near they must be, px.
const BRIGHTEST: usize = 15;
const NEAR_PX: f64 = 0.5;
/// A solution is right where no corner of the picture, nor its centre, is further off than this, px.
const RIGHT_PX: f64 = 30.0;
/// One σ of a source as it comes, px: a centroid by day.
const SIGMA_PX: f64 = 0.3;

/// What solves a list of sources.
struct Matcher<'a> {
    settings: &'a Settings,
    field: &'a Field,
}

impl Matcher<'_> {
    /// How the search for sources of a frame of this truth ends, in a word.
    fn solve(&self, sources: &[ViewSource], frame: &Frame, truth: &Truth) -> &'static str {
        let platescale = self.field.geometry.platescale;
        let (width, height, rows) = (frame.width, frame.height, frame.rows);
        let camera = CameraModel { width, height, platescale, k1: 0.0, rows, mirrored: false };
        let spot = |source: &ViewSource| {
            let (left, up) = camera.offsets(source.x, source.y);
            PatternSource::new(left, up, SIGMA_PX, source.flux, platescale)
        };
        let sources: Vec<PatternSource> = sources.iter().map(spot).collect();
        let geometry = FrameGeometry::new(&self.settings.solver, self.field, frame.width, frame.height);
        let matching = &self.settings.solver.matching;
        let rules = SearchRules {
            min_matched: matching.min_matched as usize,
            max_false_ln: matching.max_false_probability_log10 * LN_10,
            budget: u64::from(matching.candidate_budget),
            region: None,
            region_only: false,
            stop: &|| None,
        };
        match PatternSearch::new(self.field, &sources, &geometry, &rules).run().0 {
            SearchEnd::Found(found) if is_right(&found.pose, truth, &geometry) => "right",
            SearchEnd::Found(_) => "WRONG",
            _ => "no",
        }
    }
}

/// Whether a pose puts the picture's centre and corners where the truth does.
fn is_right(pose: &Pose, truth: &Truth, geometry: &FrameGeometry) -> bool {
    let Some(attitude) = &truth.attitude else { return false };
    let (w, h) = (geometry.size.0 / 2.0, geometry.size.1 / 2.0);
    [(0.0, 0.0), (w, h), (w, -h), (-w, h), (-w, -h)].into_iter().all(|(left, up)| {
        let there = attitude.to_sky(&Vec3::new(left * truth.platescale, up * truth.platescale, 1.0));
        pose.project(&there, geometry.half_diagonal).is_some_and(|(l, u)| (l - left).hypot(u - up) < RIGHT_PX)
    })
}

/// How many of some places a source is near to.
fn found(sources: &[ViewSource], places: impl Iterator<Item = (f64, f64)>) -> usize {
    places.filter(|(x, y)| sources.iter().any(|s| (s.x - x).hypot(s.y - y) <= NEAR_PX)).count()
}

/// Bytes of the differences between neighbours in Rice codes, the best parameter for each 256 of them.
fn rice_bytes(frame: &Frame) -> usize {
    let rows = frame.pixels.chunks(frame.width);
    let differences: Vec<u32> = rows
        .flat_map(|row| row.windows(2).map(|pair| i32::from(pair[1]) - i32::from(pair[0])))
        .map(|d| (d << 1 ^ d >> 31) as u32)
        .collect();
    let bits = |some: &[u32], k: u32| some.iter().map(|value| (value >> k) as usize + 1 + k as usize).sum::<usize>();
    differences.chunks(256).map(|some| 4 + (0..16).map(|k| bits(some, k)).min().unwrap()).sum::<usize>() / 8
}

/// Bytes of the pixels as PNG, which is deflate behind the best of five predictors.
fn png_bytes(frame: &Frame) -> usize {
    let mut bytes = Vec::new();
    stars::image::write_png(frame, &mut bytes).unwrap();
    bytes.len()
}

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let settings = Arc::new(Settings::flight().unwrap());
    let mut solver = Solver::new(catalogue.clone(), settings.clone());
    let mut field = None;
    let (mut encode, mut decode, mut sizes) = (Vec::new(), Vec::new(), Vec::new());
    println!(
        "{} frames of kind {}, seed {}, {} of packets and requests lost",
        args.frames,
        args.kind.name(),
        args.seed,
        args.loss
    );
    for index in 0..args.frames {
        let rendered = render(&RenderSpec::new(args.kind, args.seed, index), &catalogue).unwrap();
        let frame = &rendered.frame;
        let field = field.get_or_insert_with(|| {
            solver.prepare(frame.width, frame.height);
            Field::build(&catalogue, &FieldKey::new(&catalogue, &settings, frame.width, frame.height), &|| true).unwrap()
        });
        let outcome = solver.solve(frame, &Prior::default(), &CpuWatch);
        let sources: Vec<ViewSource> = outcome.sources.iter().map(|s| ViewSource { x: s.x, y: s.y, flux: s.flux }).collect();
        let (view, encode_ms) = timed(|| View::new(frame, &sources, PACKET_BYTES).unwrap());
        let mut assembly = Assembly::new(Some(view.stream()), MOST_PIXELS);
        let mut link = ThinLink::new(&view, args.loss, args.seed + index);
        let first = view.first_packets() as u32;
        while assembly.missing(1).first().is_some_and(|gap| gap.start < first) {
            link.round(&mut assembly);
        }
        let first_bytes = link.bytes;
        let thumbnail = assembly.thumbnail().unwrap();
        let brightest = sources.len().min(BRIGHTEST);
        let got = found(assembly.sources(), sources.iter().take(BRIGHTEST).map(|s| (s.x, s.y)));
        let true_stars = &rendered.truth.stars[..rendered.truth.stars.len().min(BRIGHTEST)];
        let got_true = found(assembly.sources(), true_stars.iter().map(|s| (s.x, s.y)));
        let solved = Matcher { settings: &settings, field }.solve(assembly.sources(), frame, &rendered.truth);
        while !assembly.is_exact() && link.bytes < 100 * view.bytes().len() {
            link.round(&mut assembly);
        }
        let exact = assembly.is_exact() && assembly.picture().is_some_and(|picture| picture.pixels == frame.pixels);
        let (_, decode_ms) = timed(|| {
            let mut again = Assembly::new(None, MOST_PIXELS);
            (0..view.len()).for_each(|n| _ = again.take(view.packet(n).unwrap()).unwrap());
            again.is_exact()
        });
        println!(
            "frame {index} exact {} sources {got}/{brightest} true_stars {got_true}/{} solved {solved} picture {}x{} \
             first_after_bytes {first_bytes} bytes {} sent_bytes {} rice {} png {} encode_ms {encode_ms:.1} decode_ms {decode_ms:.1}",
            if exact { "yes" } else { "NO" },
            true_stars.len(),
            thumbnail.width,
            thumbnail.height,
            view.bytes().len(),
            link.bytes,
            rice_bytes(frame),
            png_bytes(frame),
        );
        encode.push(encode_ms);
        decode.push(decode_ms);
        sizes.push(view.bytes().len() as f64);
    }
    let [encode, decode, size] = [&mut encode, &mut decode, &mut sizes].map(|values| quantile(values, 0.5));
    println!("medians: {size:.0} bytes, encoded in {encode:.1} ms, decoded in {decode:.1} ms of thread CPU time");
}
