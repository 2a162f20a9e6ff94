//! The state machine against the simulated controller, in made-up time.

use crate::world::{World, second, settings};
use proptest::prelude::*;
use stars::lens::{AperturePosition, Doubt, FocusCounts, FocusKept, Known, LensCommand, LensError, LensResult, Rules};
use stars::simulate::lens::FaultKind;

fn focus(counts: i32) -> Known<FocusCounts> {
    Known::Known(FocusCounts(counts))
}

#[test]
fn each_command_does_what_it_says_and_is_read_back() {
    let mut world = World::known(&settings(), 1);
    for (command, at, open) in [
        (LensCommand::SetFocus(FocusCounts(3030)), 3030, 0),
        (LensCommand::MoveFocus(-30), 3000, 0),
        (LensCommand::SetAperture(AperturePosition(6)), 3000, 6),
        (LensCommand::GetFocus, 3000, 6),
        (LensCommand::GetAperture, 3000, 6),
        (LensCommand::Flush, 3000, 6),
        (LensCommand::InitAperture, 3000, 0),
        (LensCommand::InitFocus, 4200, 0),
        (LensCommand::Stop, 4200, 0),
    ] {
        let asked = world.ask(command);
        assert_eq!(world.end_of(asked), LensResult::Completed, "{command:?}");
        let state = world.state();
        assert_eq!((state.focus, state.aperture), (focus(at), Known::Known(AperturePosition(open))), "{command:?}");
        assert_eq!(state.range, Some((FocusCounts(0), FocusCounts(4200))));
    }
    assert!(world.state().errors.is_empty(), "{:?}", world.state().errors);
}

#[test]
fn a_value_is_hidden_while_a_request_is_open_and_moving_while_it_moves() {
    let mut world = World::known(&settings(), 1);
    world.ask(LensCommand::SetFocus(FocusCounts(3800)));
    assert_eq!(world.state().focus, Known::Unknown(Doubt::Requested));
    let now = world.now;
    world.run_until(now + second(0.5));
    assert_eq!(world.state().focus, Known::Moving);
    world.ask(LensCommand::SetAperture(AperturePosition(3)));
    assert_eq!(world.state().aperture, Known::Unknown(Doubt::Requested));
    world.run_until(now + second(3.0));
    assert_eq!((world.state().focus, world.state().aperture), (focus(3800), Known::Known(AperturePosition(3))));
}

#[test]
fn what_is_outside_the_range_is_refused_and_nothing_moves() {
    let mut world = World::known(&settings(), 1);
    for command in [
        LensCommand::SetFocus(FocusCounts(4201)),
        LensCommand::SetFocus(FocusCounts(-1)),
        LensCommand::MoveFocus(1401),
        LensCommand::MoveFocus(i32::MIN),
        LensCommand::SetAperture(AperturePosition(-1)),
    ] {
        let asked = world.ask(command);
        assert!(matches!(world.end_of(asked), LensResult::Failed(LensError::OutOfRange { .. })), "{command:?}");
    }
    assert_eq!(world.state().focus, focus(2800));
    assert!(world.controller.received().all(|received| !crate::world::moves(&received.word)));
}

#[test]
fn a_stop_ends_what_waits_at_once_and_the_move_that_has_begun_is_shown_until_its_reply() {
    let mut world = World::known(&settings(), 1);
    let moving = world.ask(LensCommand::SetFocus(FocusCounts(3800)));
    let now = world.now;
    world.run_until(now + second(0.3));
    let waiting =
        [LensCommand::SetFocus(FocusCounts(100)), LensCommand::MoveFocus(5), LensCommand::SetAperture(AperturePosition(1))]
            .map(|command| world.ask(command));
    let read = world.ask(LensCommand::GetFocus);
    let stop = world.ask(LensCommand::Stop);
    assert_eq!(world.ended[&stop], LensResult::Completed);
    assert!(waiting.iter().all(|one| world.ended[one] == LensResult::Failed(LensError::Stopped)));
    assert_eq!(world.state().focus, Known::Moving);
    assert_eq!((world.end_of(moving), world.end_of(read)), (LensResult::Completed, LensResult::Completed));
    assert_eq!(world.state().focus, focus(3800));
    assert!(world.state().stopped);
    for command in [LensCommand::MoveFocus(-100), LensCommand::SetAperture(AperturePosition(1))] {
        assert!(world.state().stopped);
        let next = world.ask(command);
        assert_eq!(world.end_of(next), LensResult::Completed);
    }
    assert!(!world.state().stopped);
}

#[test]
fn a_stop_before_the_word_that_moves_is_sent_keeps_it_back() {
    let mut world = World::known(&settings(), 1);
    let asked = world.ask(LensCommand::SetFocus(FocusCounts(3800)));
    world.ask(LensCommand::Stop);
    assert_eq!(world.ended[&asked], LensResult::Failed(LensError::Stopped));
    world.run_until(second(60.0));
    assert_eq!(world.state().focus, focus(2800));
}

#[test]
fn more_than_can_wait_is_refused() {
    let mut world = World::known(&settings(), 1);
    let all: Vec<u32> = (0..20).map(|_| world.ask(LensCommand::GetFocus)).collect();
    let busy = all.iter().filter(|one| world.ended.get(one) == Some(&LensResult::Failed(LensError::Busy))).count();
    assert_eq!(busy, 3, "one is under way, and 16 wait");
    assert_eq!(world.end_of(all[16]), LensResult::Completed);
}

#[test]
fn without_a_controller_all_is_refused_at_once() {
    let mut world = World::new(&settings(), 1);
    world.inject(FaultKind::Vanished, 30.0);
    world.run_until(second(1.0));
    let asked = world.ask(LensCommand::GetFocus);
    assert_eq!(world.ended[&asked], LensResult::Failed(LensError::NotConnected));
    world.run_until(second(40.0));
    assert_eq!(world.state().focus, focus(2800));
}

#[test]
fn after_a_power_cycle_the_lens_is_learned_anew_and_goes_back_unless_that_is_not_wanted() {
    let cycle = |relearn: bool, stop: bool| {
        let mut world = World::known(&stars::settings::LensSettings { relearn, ..settings() }, 1);
        let asked = world.ask(LensCommand::SetAperture(AperturePosition(4)));
        assert_eq!(world.end_of(asked), LensResult::Completed);
        if stop {
            world.ask(LensCommand::Stop);
        }
        world.inject(FaultKind::PowerCycle, 3.0);
        world.run_until(second(90.0));
        world
    };
    let world = cycle(true, false);
    assert_eq!((world.state().focus, world.state().aperture), (focus(2800), Known::Known(AperturePosition(4))));
    for (relearn, stop) in [(false, false), (true, true)] {
        let mut world = cycle(relearn, stop);
        let state = world.state();
        assert_eq!((state.focus, state.range), (Known::Unknown(Doubt::PowerCycled), None));
        assert_eq!(state.aperture, Known::Unknown(Doubt::PowerCycled));
        let moved = world.controller.received().filter(|received| crate::world::moves(&received.word)).count();
        assert_eq!(moved, 1, "it moved by itself");
        if !relearn {
            let refused = world.ask(LensCommand::SetFocus(FocusCounts(2900)));
            assert_eq!(world.end_of(refused), LensResult::Failed(LensError::NotLearned));
        }
        let learned = world.ask(LensCommand::InitFocus);
        assert_eq!(world.end_of(learned), LensResult::Completed);
        assert_eq!(world.state().focus, focus(4200), "a command to learn ends where it ends");
    }
}

#[test]
fn a_restart_while_the_lens_is_learned_anew_does_not_leave_it_where_learning_ended() {
    for tenths in 0..400 {
        let mut world = World::known(&settings(), 1);
        world.inject(FaultKind::PowerCycle, 3.0);
        world.run_until(world.now + second(f64::from(tenths) / 10.0));
        let state = world.state();
        let known = state.focus.value().map_or(FocusKept::At(FocusCounts(2800)), FocusKept::At);
        world.restart(state.going_back.map_or(known, FocusKept::GoingBack));
        world.run_until(world.now + second(120.0));
        assert_eq!(world.state().focus, focus(2800), "after {tenths} tenths of a second: {state:?}");
        assert_eq!(world.controller.true_motor(world.now), 2800.0);
    }
}

#[test]
fn counts_that_were_lost_are_not_believed_until_they_are_learned_and_a_command_may_move_all_the_same() {
    let mut world = World::known(&stars::settings::LensSettings { relearn: false, ..settings() }, 1);
    world.inject(FaultKind::CountsLost, 1.0);
    let asked = world.ask(LensCommand::SetFocus(FocusCounts(3000)));
    let error = LensError::CountsLost { was: 2800, read: 2740 };
    assert_eq!(world.end_of(asked), LensResult::Failed(error));
    world.run_until(second(120.0));
    let asked = world.ask(LensCommand::GetFocus);
    assert_eq!(world.end_of(asked), LensResult::Failed(LensError::InDoubt { read: 2740 }));
    assert_eq!(world.state().focus, Known::Unknown(Doubt::CountsLost));
    assert!(world.controller.received().all(|received| !crate::world::moves(&received.word)));
    let asked = world.ask(LensCommand::MoveFocus(100));
    assert_eq!(world.end_of(asked), LensResult::Failed(LensError::InDoubt { read: 2840 }));
    assert_eq!((world.state().focus, world.controller.true_motor(world.now)), (Known::Unknown(Doubt::CountsLost), 2900.0));
    let learned = world.ask(LensCommand::InitFocus);
    assert_eq!(world.end_of(learned), LensResult::Completed);
    let asked = world.ask(LensCommand::SetFocus(FocusCounts(2800)));
    assert_eq!((world.end_of(asked), world.state().focus), (LensResult::Completed, focus(2800)));
}

#[test]
fn a_lens_that_was_never_known_is_not_moved_unless_the_settings_say_so() {
    for (init_on_startup, wanted) in [(false, Known::Unknown(Doubt::NotLearned)), (true, focus(4200))] {
        let mut world = World::new(&stars::settings::LensSettings { init_on_startup, ..settings() }, 1);
        world.inject(FaultKind::PowerCycle, 1.0);
        world.run_until(second(60.0));
        assert_eq!(world.state().focus, wanted);
        let moved = world.controller.received().any(|received| crate::world::moves(&received.word));
        assert_eq!(moved, init_on_startup);
    }
}

#[test]
fn learning_by_itself_is_not_done_again_and_again() {
    let mut world = World::known(&settings(), 1);
    for _ in 0..20 {
        world.inject(FaultKind::PowerCycle, 1.0);
        world.run_until(world.now + second(60.0));
    }
    let learned = world.controller.received().filter(|received| received.word == "la").count();
    assert!((2..=3).contains(&learned), "{learned} times in 20 minutes");
}

fn command() -> impl Strategy<Value = LensCommand> {
    prop_oneof![
        Just(LensCommand::Flush),
        Just(LensCommand::InitFocus),
        Just(LensCommand::GetFocus),
        (-50..4300).prop_map(|to| LensCommand::SetFocus(FocusCounts(to))),
        // Not by what the controller loses: a move that all of its counts are lost of can't be told from one that was not made.
        prop_oneof![-500..-70, -50..50, 70..500].prop_map(LensCommand::MoveFocus),
        Just(LensCommand::InitAperture),
        Just(LensCommand::GetAperture),
        (0..25).prop_map(|to| LensCommand::SetAperture(AperturePosition(to))),
        Just(LensCommand::Stop),
    ]
}

#[derive(Debug, Clone)]
enum Deed {
    Ask(LensCommand),
    Break(FaultKind, f64),
    Wait(f64),
}

fn deed() -> impl Strategy<Value = Deed> {
    prop_oneof![
        3 => command().prop_map(Deed::Ask),
        1 => (prop::sample::select(FaultKind::ALL.to_vec()), 0.1..40.0).prop_map(|(kind, lasts)| Deed::Break(kind, lasts)),
        3 => prop_oneof![0.0..0.2, 0.0..3.0, 0.0..60.0].prop_map(Deed::Wait),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// What must hold at any moment is checked by the world itself, after each event.
    #[test]
    fn whatever_is_asked_and_whatever_breaks_what_is_known_is_right(deeds in prop::collection::vec(deed(), 1..40), seed in 0..1000u64) {
        let settings = settings();
        let rules = Rules::of(&settings);
        let longest = rules.longest(LensCommand::InitFocus) * 18;
        let mut world = World::known(&settings, seed);
        let mut losing = second(0.0);
        for deed in deeds {
            match deed {
                Deed::Ask(command) => { world.ask(command); }
                // Counts that are lost while something else is wrong, or in a move that nobody can verify, may go unseen.
                Deed::Break(FaultKind::CountsLost | FaultKind::CountsLostMoving, _) if !world.is_calm() => {}
                Deed::Break(kind @ (FaultKind::CountsLost | FaultKind::CountsLostMoving), lasts) => {
                    world.inject(kind, lasts);
                    losing = world.now + second(lasts + 60.0);
                }
                Deed::Break(kind, lasts) if world.now >= losing => world.inject(kind, lasts),
                Deed::Break(..) => {}
                Deed::Wait(time) => world.run_until(world.now + second(time)),
            }
            for (command, taken) in world.overdue() {
                prop_assert!(taken <= longest, "{:?} takes {:?}", command, taken);
            }
        }
        let limit = world.now + second(40.0) + longest;
        world.run_until(world.now + second(100.0));
        while !world.overdue().is_empty() {
            prop_assert!(world.now < limit, "{:?}", world.overdue());
            world.run_until(world.now + second(1.0));
        }
        // The faults are over: what the lens is asked now, it does.
        let learn = world.ask(LensCommand::InitFocus);
        prop_assert_eq!(world.end_of(learn), LensResult::Completed);
        let ask = world.ask(LensCommand::SetFocus(FocusCounts(2900)));
        prop_assert_eq!(world.end_of(ask), LensResult::Completed);
        prop_assert_eq!(world.state().focus, focus(2900));
    }
}
