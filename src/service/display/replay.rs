//! `/replay`: what other settings would have given on the last frames, in words.

use super::site::Site;
use crate::image::ImageCounter;
use crate::journal::OutcomeMark;
use crate::service::replay::{Again, Now};
use crate::service::replayer::ReplayError;
use crate::sky::{ARCSEC, DEG, direction, separation, wrap_pi};
use crate::solve::Reason;
use axum::extract::{Query, State};
use axum::http::header::RETRY_AFTER;
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

/// Settings that may be wished together.
const MOST_SETTINGS: usize = 32;
/// Bytes that one may have: more than the longest list needs.
const LONGEST_SETTING: usize = 1024;
/// Whoever finds another replay under way, or no time for one, may ask again after this, s.
const AGAIN_AFTER_S: &str = "5";

/// What is asked for.
#[derive(Debug, Default, PartialEq, Eq)]
struct Asked {
    /// Of which image; `None` of all of the last.
    image: Option<ImageCounter>,
    /// The settings that are wished, `key=value`.
    set: Vec<String>,
}

impl Asked {
    /// Of the parameters of an address; the error says which of them is wrong.
    fn of(parameters: Vec<(String, String)>) -> Result<Self, String> {
        let mut asked = Self::default();
        for (name, value) in parameters {
            match &*name {
                "image" => {
                    let number = value.parse().map_err(|_| format!("image must be the number of one, not '{}'", cut(&value)))?;
                    asked.image = Some(ImageCounter(number));
                }
                "set" if value.len() > LONGEST_SETTING => {
                    return Err(format!("a setting has at most {LONGEST_SETTING} bytes, and '{}…' has more", cut(&value)));
                }
                "set" if asked.set.len() == MOST_SETTINGS => {
                    return Err(format!("at most {MOST_SETTINGS} settings may be wished"));
                }
                "set" => asked.set.push(value),
                other => return Err(format!("'{}' is not known here: image=N and set=key=value are", cut(other))),
            }
        }
        Ok(asked)
    }
}

/// The beginning of what was given.
fn cut(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Answers `/replay`.
pub async fn replay(State(site): State<Arc<Site>>, Query(parameters): Query<Vec<(String, String)>>) -> Response {
    let Asked { image, set } = match Asked::of(parameters) {
        Ok(asked) => asked,
        Err(why) => return (StatusCode::BAD_REQUEST, why + "\n").into_response(),
    };
    match site.replay(image, set.clone()).await {
        Ok(frames) if image.is_none() => lines(&set, &frames).into_response(),
        Ok(frames) => {
            let is_there = frames.iter().any(|again| matches!(again.now, Now::Again { .. }));
            let status = if is_there { StatusCode::OK } else { StatusCode::NOT_FOUND };
            (status, at_length(&set, &frames)).into_response()
        }
        Err(error) => refused(&error),
    }
}

fn refused(error: &ReplayError) -> Response {
    let status = match error {
        ReplayError::Refused(_) => StatusCode::BAD_REQUEST,
        ReplayError::Nothing | ReplayError::Gone { .. } => StatusCode::NOT_FOUND,
        ReplayError::Busy | ReplayError::Strained | ReplayError::NoTime => StatusCode::SERVICE_UNAVAILABLE,
        ReplayError::Broken(_) => StatusCode::INTERNAL_SERVER_ERROR,
    };
    let mut response = (status, format!("{error}\n")).into_response();
    if status == StatusCode::SERVICE_UNAVAILABLE {
        response.headers_mut().insert(RETRY_AFTER, HeaderValue::from_static(AGAIN_AFTER_S));
    }
    response
}

/// One image, solved twice where there are two.
fn at_length(set: &[String], frames: &[Again]) -> String {
    let blocks = frames.iter().enumerate().map(|(place, again)| {
        let which = match frames.len() {
            1 => String::new(),
            count => format!(", {} of the {count} times that it was solved", place + 1),
        };
        let head = format!("image {} ({}){which}\n{}\n", again.image.0, again.origin, wished(set));
        let then = format!("then     {}\n", whole(&again.was));
        let rest = match &again.now {
            Now::Not(why) => format!("now      not solved again: {why}\n"),
            Now::Again { differs, .. } if differs.is_empty() => "now      no difference: the same to the last bit\n".to_owned(),
            Now::Again { outcome, differs } => {
                let apart = apart(&again.was, outcome).map(|apart| format!("apart    {apart}\n")).unwrap_or_default();
                format!("now      {}\n{apart}differs  in {}\n", whole(outcome), differs.join(", "))
            }
        };
        head + &then + &rest
    });
    blocks.collect::<Vec<_>>().join("\n")
}

/// A line for each of the last frames, and their count.
fn lines(set: &[String], frames: &[Again]) -> String {
    let line = |again: &Again| {
        let now = match &again.now {
            Now::Not(why) => format!("not solved again: {why}"),
            Now::Again { differs, .. } if differs.is_empty() => "no difference".to_owned(),
            Now::Again { outcome, .. } => {
                let apart = apart(&again.was, outcome).map(|apart| format!("; {apart}")).unwrap_or_default();
                format!("now {}{apart}", brief(outcome))
            }
        };
        format!("image {}  {}  →  {now}\n", again.image.0, brief(&again.was))
    };
    let run: Vec<_> = frames
        .iter()
        .filter_map(|again| match &again.now {
            Now::Again { outcome, .. } => Some((&again.was, outcome)),
            Now::Not(_) => None,
        })
        .collect();
    let (differ, not_run) = (frames.iter().filter(|again| again.differs()).count(), frames.len() - run.len());
    let then = run.iter().filter(|(was, _)| was.reason == Reason::Solved).count();
    let now = run.iter().filter(|(_, now)| now.reason == Reason::Solved).count();
    let count = format!(
        "{} frames: {differ} differ, {} do not, {not_run} could not be solved again; {then} were solved then and {now} now\n",
        frames.len(),
        run.len() - differ
    );
    format!("the last frames\n{}\n{}\n{count}", wished(set), frames.iter().map(line).collect::<String>())
}

/// The settings that are wished, one a line.
fn wished(set: &[String]) -> String {
    match set {
        [] => "with the settings that they were solved with\n".to_owned(),
        set => set.iter().map(|one| format!("with {one}\n")).collect(),
    }
}

/// How a frame ended, with all that is known of it.
fn whole(mark: &OutcomeMark) -> String {
    let Some((ra, dec, roll)) = mark.pointing else { return brief(mark) };
    let [ra, dec, roll] = [ra, dec, roll].map(|angle| angle / DEG);
    let sigmas = mark.sigmas.map_or_else(String::new, |sigmas| {
        let [east, north, roll] = sigmas.map(|sigma| sigma / ARCSEC);
        format!("\n         σ {east:.2}″ east, {north:.2}″ north, {roll:.1}″ in roll")
    });
    format!("{}, {} stars matched\n         RA {ra:.5}° Dec {dec:+.5}° roll {roll:.4}°{sigmas}", mark.reason, mark.matched)
}

/// How a frame ended, in some words.
fn brief(mark: &OutcomeMark) -> String {
    let detail = if mark.detail.is_empty() { String::new() } else { format!(": {}", mark.detail) };
    if mark.pointing.is_none() {
        return format!("{}{detail}", mark.reason);
    }
    // Of either axis, as that of one number can say.
    let sigma = mark.sigmas.map_or_else(String::new, |[east, north, _]| {
        format!(", σ {:.2}″", (0.5 * (east * east + north * north)).sqrt() / ARCSEC)
    });
    format!("{}, {} stars{sigma}", mark.reason, mark.matched)
}

/// How far two pointings are apart, where there are two.
fn apart(then: &OutcomeMark, now: &OutcomeMark) -> Option<String> {
    let ((ra, dec, roll), (other_ra, other_dec, other_roll)) = (then.pointing?, now.pointing?);
    let boresight = separation(&direction(ra, dec), &direction(other_ra, other_dec)) / ARCSEC;
    let turned = wrap_pi(other_roll - roll) / ARCSEC;
    Some(format!("{boresight:.3}″ in boresight, {turned:+.2}″ in roll"))
}
