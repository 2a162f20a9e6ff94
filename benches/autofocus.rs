//! scratch
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "a bench may end where it stands")]
use stars::catalog::Catalogue;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::solve::{Prior, Solver, Unwatched};
use std::sync::Arc;
fn main() {
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let mut solver = Solver::new(catalogue.clone(), Arc::new(Settings::flight().unwrap()));
    for index in 0..4u64 {
        for disc in [0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 25.0, 30.0, 36.0] {
            let spec = RenderSpec { disc_px: Some(disc), camera: Some(3), ..RenderSpec::new(Kind::Float, 3, index) };
            let r = render(&spec, &catalogue).unwrap();
            let o = solver.solve(&r.frame, &Prior::default(), &Unwatched);
            let st = o.statistics.unwrap();
            let mut s = String::new();
            let br = o.sources.iter().filter(|s| !s.saturated).map(|s| s.peak).fold(0.0, f64::max);
            if let Some(sol) = &o.solution {
                for t in r.truth.stars.iter().take(7) {
                    let m = sol.matches.iter().find(|m| m.star == t.star).map(|m| o.sources[m.source]);
                    let sg = r.truth.psf_sigma_px;
                    let u = disc * disc / (8.0 * sg * sg);
                    let g = if u > 1e-6 { (1.0 - (-u).exp()) / u } else { 1.0 };
                    let expect = t.flux_adu / (2.0 * 3.1416 * sg * sg) * g;
                    s += &format!(
                        " {:.0}/{:.0}({:.1})",
                        m.map_or(-1.0, |m| m.peak),
                        expect,
                        m.map_or(0.0, |m| (m.flux / m.peak).sqrt())
                    );
                }
            }
            println!(
                "{index} disc {disc:4} {:?} {:?} n {} noise {:.1} gain {:?} fwhm {:.2} sig {:.2} br {br:.0} matched {} {s}",
                o.reason,
                o.mode,
                o.sources.len(),
                st.noise,
                st.gain,
                st.fwhm_px.unwrap_or(0.0),
                r.truth.psf_sigma_px,
                o.solution.as_ref().map_or(0, |s| s.matches.len())
            );
        }
    }
}
