//! Messages whose bytes are kept: values chosen so that a mistaken offset, sign, width or byte order shows.

use stars::command::{Act, Stage};
use stars::image::ExposedBy;
use stars::sky::ClockQuality;
use stars::solve::{Cause, Reason, SearchMode};
use stars::wire::*;

/// Every golden message by the name of its file.
pub fn all() -> Vec<(&'static str, Message)> {
    vec![
        ("hello_camera", Message::Hello(Box::new(hello(Role::Camera, 1, "xsc0", Some(0xDEAD_BEEF))))),
        ("hello_flight_computer", Message::Hello(Box::new(hello(Role::FlightComputer, 2, "fc2", None)))),
        ("refuse", Message::Refuse(Box::new(refuse()))),
        ("status", Message::Status(Box::new(status()))),
        ("status_nothing_known", Message::Status(Box::default())),
        ("update_solved", Message::Update(Box::new(update(Some(solved()))))),
        ("update_unsolved", Message::Update(Box::new(update(Some(unsolved()))))),
        ("update_no_image", Message::Update(Box::new(update(None)))),
        ("gyro", Message::Gyro(Box::new(gyro()))),
        ("commands", Message::Commands(Box::new(commands()))),
        ("commands_none", Message::Commands(Box::default())),
        ("image_request", Message::ImageRequest(Box::new(image_request()))),
        ("image_request_newest", Message::ImageRequest(Box::new(newest_image()))),
        ("image_chunk", Message::ImageChunk(Box::new(image_chunk()))),
        ("image_refusal", Message::ImageRefusal(Box::new(image_refusal()))),
    ]
}

/// Not [`Hello::new`]: the bytes kept may not change with the program's own version.
fn hello(role: Role, id: u8, name: &str, settings_hash: Option<u32>) -> Hello {
    Hello {
        magic: Text::new(MAGIC),
        version_min: 1,
        version_current: 1,
        schema_hash: Some(0x1234_5678u32).into(),
        role: role.into(),
        id,
        name: Text::new(name),
        boot_id: 0x8765_4321.into(),
        build: Text::new("0.1.0 \"golden\""),
        settings_hash: settings_hash.into(),
    }
}

fn refuse() -> Refuse {
    Refuse { refusal: Refusal::NoCommonVersion.into(), version_min: 1, version_current: 1, detail: Text::new("you speak 7 to 9") }
}

fn clock(unix_s: f64, quality: ClockQuality) -> Clock {
    Clock { clock_unix_s: Some(unix_s).into(), clock_quality: quality.into() }
}

fn status() -> Status {
    Status {
        sequence: 4_000_000_001.into(),
        boot_id: 0x0102_0304.into(),
        uptime_s: 86_400.25,
        claims_charge: true,
        clock: clock(1_357_020_684.859, ClockQuality::Synchronised),
        observer: Some(ObserverPart { latitude_deg: -76.938_995_5, sidereal_time_h: 12.245_277_777_777_8 }).into(),
        horizontal_estimate: Some(HorizontalEstimate { az_deg: 301.268, el_deg: 51.904 }).into(),
        equatorial_estimate: Some(EquatorialEstimate { ra_deg: 136.564_602, dec_deg: -43.967_823 }).into(),
        trigger_counter: Some(70_001u32).into(),
        trigger_image_counter: Some(70_002u32).into(),
        trigger_age_s: Some(0.375).into(),
        trigger_pulses: 70_003.into(),
        updates_received: 11.into(),
        last_update_sequence: Some(12u32).into(),
    }
}

fn update(image: Option<Image>) -> Update {
    let known = image.is_some();
    Update {
        link: Link {
            sequence: 513.into(),
            boot_id: 0xA1B2_C3D4.into(),
            uptime_s: 1234.5,
            clock: Clock::new(None, ClockQuality::Unset),
            settings_hash: 0xDEAD_BEEF.into(),
            simulated_camera: true,
            simulated_lens: false,
            statuses_received: 510.into(),
            last_status_sequence: Some(509u32).into(),
            last_status_age_s: Some(0.125).into(),
            status_values_withheld: 3.into(),
        },
        authority: Authority {
            in_charge_id: known.then_some(2).into(),
            in_charge_since_s: known.then_some(17.75).into(),
            you_are_in_charge: known,
            claims: 2,
            commands_accepted: 21.into(),
            commands_refused: 22.into(),
            last_refusal: known.then_some(stars::command::Refusal::HalfChanged).into(),
        },
        counters: Counters {
            frames_taken: 101.into(),
            frames_solved: 102.into(),
            frames_skipped: 103.into(),
            frames_lost: 104.into(),
            restarts_camera: 105.into(),
            restarts_solver: 106.into(),
            restarts_hub: 107.into(),
            restarts_recorder: 108.into(),
            restarts_server: 109.into(),
            links_refused: 110.into(),
            solving: true,
        },
        housekeeping: Housekeeping {
            temperature_lens_c: Some(-40.5).into(),
            temperature_computer_c: Some(31.25).into(),
            temperature_vessel_c: Some(20.125).into(),
            temperature_plate_c: Maybe::unknown(),
            temperature_dcdc_c: Some(45.0).into(),
            temperature_flange_c: Some(-12.75).into(),
            pressure_atm: Some(0.987).into(),
            disk_free_gib: Some(431.5).into(),
        },
        camera: Camera {
            next_image_counter: 70_010.into(),
            gain_db: Some(-3.5).into(),
            focus_counts: Some(-3030).into(),
            aperture_counts: Some(14).into(),
        },
        image: image.into(),
        control: if known { control() } else { Control::default() },
        lens: if known { lens() } else { Lens::default() },
        focus: if known { focus() } else { Focus::default() },
        health: if known { health() } else { Health::default() },
        series: known.then(series).into(),
        clocks: if known { clocks() } else { Clocks::default() },
        triggers: if known { triggers() } else { Triggers::default() },
        times: if known { times() } else { Times::default() },
    }
}

fn triggers() -> Triggers {
    Triggers {
        exposing: ExposedBy::Itself.into(),
        last_triggered_age_s: Some(123.4375).into(),
        triggers_stayed_away: 70_014.into(),
        image_exposed_by: Some(Coded::from(ExposedBy::Trigger)).into(),
    }
}

fn times() -> Times {
    Times {
        clock_sigma_s: Some(0.001953125).into(),
        captured_sigma_s: Some(0.00390625).into(),
        captured_uptime_s: Some(1233.75).into(),
    }
}

fn clocks() -> Clocks {
    let clock = |flight_computer: u8, offset_s: f64| PeerClock { flight_computer, offset_s, sigma_s: 0.0625, age_s: 0.3125 };
    Clocks { clocks_count: 2, clocks: List::from_slice(&[clock(1, -0.015625), clock(2, 31_536_000.5)]) }
}

fn series() -> Series {
    let start = SeriesStart {
        start_ra_deg: 136.571_25,
        start_dec_deg: -43.953_125,
        start_roll_deg: -165.75,
        start_sigma_east_arcsec: 1.625,
        start_sigma_north_arcsec: 2.375,
        start_before_middle_s: 0.4375,
    };
    Series { missing_packets: 70_012.into(), missed_images: 70_013.into(), start: Some(start).into() }
}

fn health() -> Health {
    Health {
        simulated_housekeeping: true,
        temperature_lens_age_s: Some(0.25).into(),
        temperature_computer_age_s: Some(0.5).into(),
        temperature_vessel_age_s: Some(0.75).into(),
        temperature_plate_age_s: Some(3600.5).into(),
        temperature_dcdc_age_s: Some(1.25).into(),
        temperature_flange_age_s: Maybe::unknown(),
        pressure_age_s: Some(1.75).into(),
        disk_free_age_s: Some(2.25).into(),
        temperature_lens_alarm: true,
        temperature_vessel_alarm: true,
        pressure_alarm: true,
        disk_days_left: Some(12.375).into(),
        run_number: Some(70_011u32).into(),
        last_end: Some(LastEnd::ComputerRestarted).into(),
        kept_at_start: Found::OneCopy.into(),
        restarts_lens: 111.into(),
        restarts_ledger: 112.into(),
        restarts_housekeeping: 113.into(),
        last_restart: Some(Actor::Recorder).into(),
        last_restart_reason: Text::new("panicked: it breaks"),
        last_restart_age_s: Some(86.5).into(),
        ..Health::default()
    }
}

fn control() -> Control {
    let refused: Vec<_> = (1..=19).map(|count: u32| (count * 1_000_003).into()).collect();
    let reply = |serial: u32, stage: Stage, why: Option<stars::command::Refusal>, words: &str| CommandReply {
        serial: serial.into(),
        flight_computer: 2,
        command: 23,
        counter: (serial * 70_000).into(),
        stage: stage.into(),
        why: why.into(),
        reply_age_s: f64::from(serial) + 0.25,
        words: Text::new(words),
    };
    Control {
        lease_epoch: Some(40_000u32).into(),
        armed_command: Some(1).into(),
        armed_for_s: 7.5,
        commands_under_way: 3,
        authentication_required: true,
        authentication_key: false,
        counters_kept: true,
        refused: List::from_slice(&refused),
        settings_commanded: 515.into(),
        ..Control::default()
    }
    .with_replies(&[
        reply(7, Stage::Completed, None, "at 3030 counts"),
        reply(8, Stage::Rejected, Some(stars::command::Refusal::NotInCharge), "its computer does not hold the lease"),
    ])
}

fn lens() -> Lens {
    let range = FocusRange { focus_nearest_counts: (-7).into(), focus_furthest_counts: 4200.into() };
    Lens {
        lens_connected: true,
        lens_moving: false,
        lens_stopped: true,
        focus_doubt: Some(stars::lens::Doubt::PowerCycled).into(),
        aperture_doubt: Maybe::unknown(),
        focus_range: Some(range).into(),
        lens_requests: 2,
        lens_errors: 70_020.into(),
        lens_last_error: Text::new("no reply to fp in time"),
    }
}

fn focus() -> Focus {
    let best = Best { best_focus_counts: 3031.25, sigma_best_focus_counts: 1.5, best_focus_drift_counts_min: -0.75 };
    let estimate = WidthEstimate {
        star_width_px: 2.375,
        focus_distance_counts: 41.5,
        sigma_focus_distance_counts: 6.25,
        focus_distance_calibrated: true,
        star_width_px_per_hour: Some(-0.125).into(),
        star_width_px_per_kelvin: Maybe::unknown(),
    };
    Focus {
        autofocus_mode: stars::lens::autofocus::Mode::Grace.into(),
        autofocus_requested_counts: Some(3031).into(),
        autofocus_run_age_s: Some(612.5).into(),
        autofocus_time_left_s: Maybe::unknown(),
        autofocus_images: 517.into(),
        autofocus_best: Some(best).into(),
        autofocus_ending: Some(FocusEnding::EdgeHigh).into(),
        focus_estimate: Some(estimate).into(),
    }
}

fn commands() -> Commands {
    let slot = |text: &str, act, counter, age_s| {
        CommandSlot::new(&stars::command::Slot::new(&stars::command::Command::parse(text).unwrap(), act, counter, age_s))
    };
    let slots = [
        slot("lens.set_focus 3030", Act::Run, 4, 1.25),
        slot("requirements.elevation 1 -5.5 60", Act::Run, 70_000, 0.5),
        slot("service.shut_down 1", Act::Fire, 2, 14.75),
    ];
    let block = Commands {
        sequence: 9.into(),
        boot_id: 0x0102_0304.into(),
        camera_boot_id: 0xA1B2_C3D4.into(),
        lease_epoch: 40_000.into(),
        last_update_sequence: Some(512u32).into(),
        acknowledged: 6.into(),
        slots_count: 3,
        slots: List::from_slice(&slots),
        tag: Maybe::unknown(),
    };
    block.signed(&stars::command::Key::parse(&"5a".repeat(32)).unwrap())
}

fn solved() -> Image {
    Image {
        cause: Maybe::unknown(),
        reason: Reason::Solved.into(),
        detail: Text::new("matched 13 of 20"),
        equatorial: Some(equatorial()).into(),
        horizontal: Some(horizontal()).into(),
        prior_disagreement_deg: Some(2.5).into(),
        sources_matched: 13.into(),
        corrections: Corrections { corrected_proper_motion: true, corrected_distortion: true, ..Corrections::default() },
        ..unsolved()
    }
}

fn unsolved() -> Image {
    let source = |place: u8| Source {
        x_px: 100.5 + f32::from(place),
        y_px: 0.1 * f32::from(place),
        sigma_px: 0.05,
        flux_adu: 12_345.0,
        peak_adu: 678.0,
        snr: 30.0 - f32::from(place),
        saturated: place == 1,
        star_id: (place != 2).then_some(1000 + u32::from(place)).into(),
    };
    Image {
        image_counter: 70_009.into(),
        image_trigger_counter: Some(70_001u32).into(),
        exposures: 4,
        exposure_s: Some(0.12).into(),
        captured_unix_s: Some(1_357_020_684.859).into(),
        captured_quality: Some(ClockQuality::FreeRunning).into(),
        image_age_s: Some(0.625).into(),
        reason: Reason::Undecided.into(),
        cause: Some(Cause::Trailed).into(),
        detail: Text::new("4 matched, 5 needed"),
        mode: SearchMode::Robust.into(),
        statistics: Some(FrameStatistics {
            mean_adu: 4096.5,
            noise_adu: 41.75,
            measured_gain_adu_per_e: Some(0.041).into(),
            measured_gain_db: Some(0.0085).into(),
            saturated_px: 70_000.into(),
            saturated_fraction: 0.0445,
            fwhm_px: Some(2.25).into(),
        })
        .into(),
        focus_metric_adu: Some(2047.5).into(),
        sources_found: 300.into(),
        sources_tried: 20.into(),
        sources_matched: 0.into(),
        candidates_tried: 123_456.into(),
        solve_time_ms: Some(3.75).into(),
        sources_count: 3,
        sources: List::from_slice(&[source(0), source(1), source(2)]),
        ..Image::default()
    }
}

fn equatorial() -> Equatorial {
    Equatorial {
        ra_deg: 136.564_602,
        dec_deg: -43.967_823,
        roll_deg: 165.252_76,
        sigma_east_arcsec: 1.25,
        sigma_north_arcsec: 1.75,
        sigma_roll_arcsec: 31.5,
        sigma_pointing_arcsec: 1.5,
        covariance_arcsec2: [[1.5625, 0.25, -2.0].into(), [0.25, 3.0625, 4.0].into(), [-2.0, 4.0, 992.25].into()].into(),
        platescale_arcsec_px: 9.4373,
        sigma_platescale_arcsec_px: Some(0.001).into(),
        distortion_k1: Some(-0.0125).into(),
        rms_px: 0.1875,
        chi2_per_dof: Some(1.0625).into(),
        false_probability_log10: Some(-23.5).into(),
        epoch_yr: Some(2013.0).into(),
    }
}

fn horizontal() -> HorizontalPart {
    HorizontalPart {
        az_deg: 301.268,
        el_deg: 51.904,
        horizontal_roll_deg: -0.823,
        sigma_az_arcsec: 1.3,
        sigma_el_arcsec: 1.7,
        sigma_horizontal_roll_arcsec: 31.5,
        sigma_horizontal_pointing_arcsec: 1.5,
        observer: ObserverPart { latitude_deg: -76.938_995_5, sidereal_time_h: 12.245_277_777_777_8 },
        equinox_yr: Some(2013.0).into(),
    }
}

fn gyro() -> Gyro {
    let exposures = [Exposure { start_s: 0.01, duration_s: 0.12 }, Exposure { start_s: 0.32, duration_s: 0.12 }];
    let samples: Vec<Rates> =
        (0..40u8).map(|place| Rates { az_rate_deg_s: 0.1 * f32::from(place), el_rate_deg_s: -0.01 * f32::from(place) }).collect();
    Gyro {
        trigger_counter: 70_001.into(),
        image_counter: 70_009.into(),
        start_uptime_s: 86_399.5,
        sample_rate_hz: 100.16,
        elevation_deg: Some(51.904).into(),
        exposures_count: 2,
        exposures: List::from_slice(&exposures),
        samples_count: 40.into(),
        samples: List::from_slice(&samples),
    }
}

fn image_request() -> ImageRequest {
    ImageRequest {
        request: 70_031.into(),
        wanted: Wanted::Image.into(),
        camera_boot_id: Some(0xA1B2_C3D4u32).into(),
        image_counter: Some(70_009u32).into(),
        exposure: 3,
        form: ImageForm::View.into(),
        offset: 70_032.into(),
        begun_crc32: Some(0x9A8B_7C6Du32).into(),
        rate_bytes_s: 70_033.into(),
    }
}

fn newest_image() -> ImageRequest {
    let rate_bytes_s = 250_000.into();
    ImageRequest { request: 1.into(), wanted: Wanted::Newest.into(), rate_bytes_s, ..ImageRequest::default() }
}

fn image_chunk() -> ImageChunk {
    let bytes: Vec<u8> = (0..=255).collect();
    ImageChunk {
        request: 70_031.into(),
        camera_boot_id: 0xA1B2_C3D4.into(),
        image_counter: 70_009.into(),
        exposure: 3,
        exposures: 4,
        form: ImageForm::Raw.into(),
        total_bytes: 3_150_720.into(),
        file_crc32: 0x9A8B_7C6D.into(),
        offset: 70_032.into(),
        bytes_count: 256.into(),
        bytes: List::from_slice(&bytes),
    }
}

fn image_refusal() -> ImageRefusal {
    let words = Text::new("image 7 is not on disk: it went to make room, or was never kept");
    ImageRefusal { request: 70_031.into(), no_image: NoImage::NotKept.into(), words }
}
