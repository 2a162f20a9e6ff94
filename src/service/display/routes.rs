//! The routes: everything is read, nothing is commanded.
//!
//! | route | gives |
//! |---|---|
//! | `/` | the page |
//! | `/state` | the state, JSON |
//! | `/events` | the state each time that it changes, as server-sent events |
//! | `/frame.json` | all that is shown of a frame |
//! | `/frame.raw` | its pixels: 16 bits, little-endian, rows in file order; `step=N` every Nth of every Nth row |
//! | `/frame.png` | its picture, drawn here |
//! | `/history.json` | the strip of the last frames |
//! | `/text`, `/text?ten=1` | the state as a page for a terminal, or ten lines |
//! | `/mask.html` | the tool for masks |
//! | `/replay` | the last frames solved again, a line each, or `image=N` at length: how each ended and how it ends now; `set=key=value`, which may be given often, with other settings |
//! | `/healthz` | `ok` while frames can be solved |
//!
//! Those of a frame take `image=N`: one of the strip instead of the last. What is solved again changes nothing, and waits for live frames:
//! see [`Replayer`](crate::service::Replayer).

use super::replay::replay;
use super::site::{NoPicture, Site};
use crate::display::{MASK_TOOL, page, ten_lines, text_page};
use crate::image::Frame;
use crate::sky::RowOrder;
use axum::Router;
use axum::body::Body;
use axum::extract::{Query, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderName, REFERRER_POLICY, RETRY_AFTER, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::map_response;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use bytes::Bytes;
use futures_util::stream;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::sync::Arc;

/// A browser loads nothing from elsewhere, whatever a page says, and shows the page in no other one's frame.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src 'self' data: blob:; \
                      connect-src 'self'; frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'";
const HTML: &str = "text/html; charset=utf-8";
const JSON: &str = "application/json";
const TEXT: &str = "text/plain; charset=utf-8";
const EVENTS: &str = "text/event-stream";
const PNG: &str = "image/png";
const RAW: &str = "application/octet-stream";

/// All routes.
pub fn routes(site: &Arc<Site>) -> Router {
    Router::new()
        .route("/", get(async || told(HTML, page())))
        .route("/mask.html", get(async || told(HTML, MASK_TOOL)))
        .route("/state", get(state))
        .route("/events", get(events))
        .route("/frame.json", get(frame_json))
        .route("/frame.raw", get(frame_raw))
        .route("/frame.png", get(frame_png))
        .route("/history.json", get(history))
        .route("/text", get(text))
        .route("/healthz", get(health))
        .route("/replay", get(replay))
        .layer(map_response(guard))
        .with_state(Arc::clone(site))
}

/// Which frame is wanted, and how.
#[derive(Debug, Deserialize)]
struct Wanted {
    image: Option<u32>,
    step: Option<usize>,
}

/// Which text is wanted.
#[derive(Debug, Deserialize)]
struct WantedText {
    ten: Option<String>,
}

/// The strip.
#[derive(Debug, Serialize)]
struct Strip<T> {
    frames: T,
    passed_over: u64,
}

async fn state(State(site): State<Arc<Site>>) -> Response {
    json(&site.snapshot())
}

async fn events(State(site): State<Arc<Site>>) -> Response {
    let newest = site.subscribe();
    let stream = stream::unfold((Some(site.event()), newest), |(first, mut newest)| async move {
        let event = match first {
            Some(first) => first,
            None => {
                // One that was slow goes on with the newest; those between are passed over.
                newest.changed().await.ok()?;
                newest.borrow_and_update().clone()
            }
        };
        Some((Ok::<_, Infallible>(event), (None, newest)))
    });
    told(EVENTS, Body::from_stream(stream))
}

async fn frame_json(State(site): State<Arc<Site>>, Query(wanted): Query<Wanted>) -> Response {
    site.view(wanted.image).map_or_else(|| refused(NoPicture::Gone), |view| json(&view))
}

async fn frame_raw(State(site): State<Arc<Site>>, Query(wanted): Query<Wanted>) -> Response {
    let frame = match site.pixels(wanted.image) {
        Ok(frame) => frame,
        Err(why) => return refused(why),
    };
    let step = wanted.step.unwrap_or(1).clamp(1, frame.width.min(frame.height).max(1));
    let rows = if frame.rows == RowOrder::TopFirst { "top" } else { "bottom" };
    let facts = [
        ("x-stars-image", frame.stamp.image.0.to_string()),
        ("x-stars-width", frame.width.div_ceil(step).to_string()),
        ("x-stars-height", frame.height.div_ceil(step).to_string()),
        ("x-stars-step", step.to_string()),
        ("x-stars-first-row", rows.to_owned()),
    ];
    let bytes = if step == 1 && cfg!(target_endian = "little") {
        // Sent from where they are.
        Bytes::from_owner(Pixels(frame))
    } else {
        match tokio::task::spawn_blocking(move || thinned(&frame, step)).await {
            Ok(bytes) => bytes,
            Err(_) => return refused(NoPicture::Broke),
        }
    };
    let mut response = told(RAW, bytes);
    for (name, value) in facts {
        if let Ok(value) = HeaderValue::try_from(value) {
            response.headers_mut().insert(HeaderName::from_static(name), value);
        }
    }
    response
}

/// A frame's pixels where they are.
struct Pixels(Arc<Frame>);

impl AsRef<[u8]> for Pixels {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0.pixels)
    }
}

/// Every pixel of so many, in either direction.
fn thinned(frame: &Frame, step: usize) -> Bytes {
    let rows = frame.pixels.chunks(frame.width.max(1)).step_by(step);
    rows.flat_map(|row| row.iter().step_by(step)).flat_map(|adu| adu.to_le_bytes()).collect()
}

async fn frame_png(State(site): State<Arc<Site>>, Query(wanted): Query<Wanted>) -> Response {
    site.picture(wanted.image).await.map_or_else(refused, |bytes| told(PNG, bytes))
}

async fn history(State(site): State<Arc<Site>>) -> Response {
    let (frames, passed_over) = site.strip();
    json(&Strip { frames, passed_over })
}

async fn text(State(site): State<Arc<Site>>, Query(wanted): Query<WantedText>) -> Response {
    let (snapshot, view) = (site.snapshot(), site.view(None));
    let text = if wanted.ten.is_some() { ten_lines(&snapshot, view.as_ref()) } else { text_page(&snapshot, view.as_ref()) };
    told(TEXT, text)
}

async fn health(State(site): State<Arc<Site>>) -> Response {
    let solver = site.snapshot().solver;
    match solver.as_str() {
        "ready" => told(TEXT, "ok\n"),
        why => (StatusCode::SERVICE_UNAVAILABLE, told(TEXT, format!("{why}\n"))).into_response(),
    }
}

fn json<T: Serialize>(what: &T) -> Response {
    match serde_json::to_vec(what) {
        Ok(bytes) => told(JSON, bytes),
        Err(_) => refused(NoPicture::Broke),
    }
}

fn told(kind: &'static str, body: impl Into<Body>) -> Response {
    ([(CONTENT_TYPE, kind)], body.into()).into_response()
}

fn refused(why: NoPicture) -> Response {
    match why {
        NoPicture::Gone => (StatusCode::NOT_FOUND, "there is no such frame here, or not any more\n").into_response(),
        NoPicture::NoTime => {
            let words = "the computer is too slow for all of its work: pictures wait\n";
            (StatusCode::SERVICE_UNAVAILABLE, [(RETRY_AFTER, "5")], words).into_response()
        }
        NoPicture::Broke => (StatusCode::INTERNAL_SERVER_ERROR, "this could not be drawn\n").into_response(),
    }
}

/// What every answer says to browsers.
async fn guard(mut response: Response) -> Response {
    let headers = response.headers_mut();
    for (name, value) in [
        (CACHE_CONTROL, "no-store"),
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}
