//! `Status`: what a flight computer says of itself, twice a second.

use super::element::body;
use super::update::Clock;
use super::{Maybe, U32Le};
use crate::image::TriggerCounter;
use crate::sky::{DEG, HOUR, Observer};
use crate::solve::Prior;

body! {
    /// What a flight computer knows, to the camera every 0.5 s.
    pub struct Status {
        /// Counts the sender's statuses of this connection, from 0.
        sequence: U32Le => "";
        /// Number drawn at random at the sender's start: another one means that it started anew.
        boot_id: U32Le => "";
        /// Time since the sender's start, from a clock that never jumps.
        uptime_s: f64 => "s" [0.0, 1e10];
        /// The sender claims to be in charge. Only what a computer in charge says is acted upon.
        claims_charge: bool => "";
        /// The sender's clock.
        clock: Clock => "";
        /// Where the gondola is and how far the sky has turned.
        observer: Maybe<ObserverPart> => "";
        /// The sender's estimate of where this camera looks, against the horizon.
        horizontal_estimate: Maybe<HorizontalEstimate> => "";
        /// The sender's estimate of where this camera looks, on the sky.
        equatorial_estimate: Maybe<EquatorialEstimate> => "";
        /// Number of the series of triggers that images downloaded from now on belong to.
        trigger_counter: Maybe<U32Le> => "";
        /// The camera's number of the image that the last series made, as the sender expects it.
        trigger_image_counter: Maybe<U32Le> => "";
        /// Time since the last trigger pulse began.
        trigger_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Trigger pulses since the sender's start.
        trigger_pulses: U32Le => "";
        /// Updates received on this connection.
        updates_received: U32Le => "";
        /// Sequence number of the last update received.
        last_update_sequence: Maybe<U32Le> => "";
    }
}

body! {
    /// An observer on Earth.
    pub struct ObserverPart {
        /// Geodetic latitude, north positive.
        latitude_deg: f64 => "deg" [-90.0, 90.0];
        /// Local apparent sidereal time.
        sidereal_time_h: f64 => "h" [0.0, 24.0];
    }
}

body! {
    /// Where the camera is thought to look, against the horizon.
    pub struct HorizontalEstimate {
        /// Azimuth, from north through east.
        az_deg: f64 => "deg" [0.0, 360.0];
        /// Elevation.
        el_deg: f64 => "deg" [-90.0, 90.0];
    }
}

body! {
    /// Where the camera is thought to look, on the sky.
    pub struct EquatorialEstimate {
        /// Right ascension, ICRS.
        ra_deg: f64 => "deg" [0.0, 360.0];
        /// Declination, ICRS.
        dec_deg: f64 => "deg" [-90.0, 90.0];
    }
}

impl Status {
    /// The observer, where the sender knows it.
    pub fn observer(&self) -> Option<Observer> {
        let part = self.observer.get()?;
        Some(Observer { latitude: part.latitude_deg * DEG, sidereal_time: part.sidereal_time_h * HOUR })
    }

    /// What this status says of the pointing before a frame is solved.
    pub fn prior(&self) -> Prior {
        Prior {
            horizontal: self.horizontal_estimate.get().map(|at| (at.az_deg * DEG, at.el_deg * DEG)),
            equatorial: self.equatorial_estimate.get().map(|at| (at.ra_deg * DEG, at.dec_deg * DEG)),
            observer: self.observer(),
            ..Prior::default()
        }
    }

    /// The series of triggers that images belong to from now on.
    pub fn trigger(&self) -> Option<TriggerCounter> {
        self.trigger_counter.get().map(|counter| TriggerCounter(counter.get()))
    }
}

impl From<Observer> for ObserverPart {
    fn from(observer: Observer) -> Self {
        Self { latitude_deg: observer.latitude / DEG, sidereal_time_h: crate::sky::wrap_two_pi(observer.sidereal_time) / HOUR }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_gives_back_the_observer_in_radians() {
        let observer = Observer { latitude: -1.2, sidereal_time: 3.0 };
        let status = Status { observer: Some(observer).into(), ..Status::default() };
        let back = status.prior().observer.unwrap();
        assert!((back.latitude + 1.2).abs() < 1e-12 && (back.sidereal_time - 3.0).abs() < 1e-12);
        assert_eq!(status.prior().horizontal, None);
    }
}
