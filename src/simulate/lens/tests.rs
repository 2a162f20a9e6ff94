//! Tests of the simulated controller by itself.

use super::*;
use crate::settings::Settings;

fn second(seconds: f64) -> Tick {
    Duration::from_secs_f64(seconds)
}

fn controller() -> Controller {
    Controller::new(&Settings::flight().unwrap().lens.simulated, 1)
}

/// What it answers to a word sent at `at`, and when.
fn ask(controller: &mut Controller, at: f64, word: &str) -> (String, f64) {
    let mut out = controller.on(second(at), format!("{word}\r").as_bytes());
    let mut now = second(at);
    while out.is_empty() {
        let Some(next) = controller.deadline() else { return (String::new(), now.as_secs_f64()) };
        now = now.max(next);
        out = controller.on(now, b"");
    }
    (String::from_utf8_lossy(&out).into_owned(), now.as_secs_f64())
}

#[test]
fn it_speaks_the_language_and_takes_the_time_of_its_moves() {
    let mut it = controller();
    assert_eq!(ask(&mut it, 1.0, "vs"), ("s:simulated 1.0\r".to_owned(), 1.02));
    assert_eq!(ask(&mut it, 2.0, "fp").0, "fmin:-137  fmax:4063  current:2663\r");
    assert_eq!(ask(&mut it, 3.0, "fa3030"), ("DONE3030,0\r".to_owned(), 3.33));
    assert_eq!(ask(&mut it, 4.0, "mf-30").0, "DONE3000,0\r");
    assert_eq!(it.true_motor(second(5.0)), 3000.0);
    assert_eq!(it.true_focus(second(5.0)), 3002.5);
    assert_eq!(ask(&mut it, 5.0, "fa9999").0, "DONE4200,1\r");
    assert_eq!(ask(&mut it, 7.0, "la"), ("DONE:LA\r".to_owned(), 7.0 + 8.4 + 0.1));
    assert_eq!(ask(&mut it, 20.0, "ma6").0, "DONE6,f6\r");
    assert_eq!(ask(&mut it, 21.0, "pa").0, "6,f6\r");
    assert_eq!(ask(&mut it, 22.0, "in").0, "DONE\r");
    for word in ["xx", "fa", "fax", "ma99", "fp1", "é"] {
        assert_eq!(ask(&mut it, 30.0, word).0, "ERR1\r", "{word}");
    }
    assert_eq!(it.on(second(40.0), b"\r"), b"");
    assert_eq!(it.received().next(), Some(&Received { at: second(1.0), word: "vs".to_owned() }));
}

#[test]
fn faults_do_what_they_say() {
    let with = |kind| {
        let mut it = controller();
        it.inject(Fault { kind, from: second(10.0), until: second(20.0) });
        it.on(second(10.0), b"");
        it
    };
    assert_eq!(ask(&mut with(FaultKind::Late), 11.0, "vs").1, 11.02 + 4.5);
    assert_ne!(ask(&mut with(FaultKind::Garbled), 11.0, "fp").0, "fmin:-137  fmax:4063  current:2663\r");
    assert_eq!(ask(&mut with(FaultKind::Error), 11.0, "fa3030").0, "ERR9\r");
    assert_eq!(ask(&mut with(FaultKind::Stall), 11.0, "fa3030"), ("DONE3030,0\r".to_owned(), 20.33));
    assert_eq!(ask(&mut with(FaultKind::Silent), 11.0, "fa3030").0, "");
    assert_eq!(ask(&mut with(FaultKind::Slip), 11.0, "fa3030").0, "DONE2990,0\r");
    assert!(!with(FaultKind::Vanished).has_port(second(19.0)));
    assert!(with(FaultKind::Vanished).has_port(second(20.0)));

    let mut stuck = with(FaultKind::StuckMotor);
    assert_eq!(ask(&mut stuck, 11.0, "fa3030"), ("DONE2800,1\r".to_owned(), 12.0));
    assert_eq!(stuck.true_motor(second(13.0)), 2800.0);

    let mut lost = with(FaultKind::CountsLost);
    assert_eq!(ask(&mut lost, 11.0, "fp").0, "fmin:-137  fmax:4063  current:2603\r");
    assert_eq!(lost.true_motor(second(13.0)), 2800.0);
    let mut lost = with(FaultKind::CountsLostMoving);
    assert_eq!(ask(&mut lost, 11.0, "fa3000").0, "DONE3000,0\r");
    assert_eq!(ask(&mut lost, 12.0, "fp").0, "fmin:-137  fmax:4063  current:2803\r");

    let mut cycled = with(FaultKind::PowerCycle);
    assert_eq!(cycled.on(second(20.4), b"fp\r"), b"");
    assert_eq!(cycled.on(second(20.5), b""), NOISE);
    assert_eq!(ask(&mut cycled, 21.0, "fp").0, "fmin:0  fmax:0  current:0\r");
    assert_eq!(ask(&mut cycled, 22.0, "fa100").0, "ERR2\r");
    assert_eq!(ask(&mut cycled, 23.0, "pa").0, "ERR1\r");
    ask(&mut cycled, 24.0, "la");
    assert_eq!(ask(&mut cycled, 40.0, "fp").0, "fmin:-2800  fmax:1400  current:1400\r");
}

#[test]
fn a_power_cycle_stops_a_move_where_it_is() {
    let mut it = controller();
    it.inject(Fault { kind: FaultKind::PowerCycle, from: second(1.2), until: second(2.0) });
    it.on(second(1.0), b"fa3800\r");
    it.on(second(1.2), b"");
    assert_eq!(it.true_motor(second(5.0)), 3000.0);
}
