//! Sessions of the legacy port on a paused clock.

use crate::settings;
use crate::support::{Peer, claim, start_without_camera};
use stars::command::legacy::{COMMANDS, Entry, FLOWN, Values};
use stars::command::{FlightComputer, Refusal, Stage};
use stars::image::{ImageCounter, Stamp, TriggerCounter};
use stars::service::{Closed, Ending, Running, State};
use stars::settings::Settings;
use stars::wire::Status;
use stars::wire::legacy::{ANSWER_BYTES, BLOCK_BYTES, Block, Recorded, Step};
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::time::{Instant, sleep};

/// A flight program of old.
struct Old {
    stream: DuplexStream,
    block: Block,
}

impl Old {
    /// Connects as the computer with this number, claiming to be in charge or not.
    async fn connect(running: &Running, computer: u8, buffer: usize) -> Self {
        let (near, far) = tokio::io::duplex(buffer);
        running.serve_legacy(far, format!("127.0.0.{computer}:9").parse().unwrap()).await;
        let values = Values([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let entry = |index: usize| Entry {
            countdown: 0,
            counter: index as i32,
            values: if FLOWN[index].values > 0 { values } else { Values::default() },
        };
        let block = Block {
            in_charge: true,
            counter_fcp: 3,
            observer: None,
            horizontal: None,
            equatorial: None,
            motion: None,
            commands: std::array::from_fn(entry),
        };
        Self { stream: near, block }
    }

    /// The ground gives a command.
    fn give(&mut self, name: &str, values: &[f64]) {
        let entry = &mut self.block.commands[FLOWN.iter().position(|flown| flown.name == name).unwrap()];
        entry.values.0[..values.len()].copy_from_slice(values);
        entry.countdown = 1500;
        entry.counter += 1;
    }

    /// Sends this many blocks, one every 0.5 s.
    async fn fly(&mut self, blocks: usize) {
        for _ in 0..blocks {
            sleep(Duration::from_millis(500)).await;
            self.block.commands.iter_mut().for_each(|entry| entry.countdown = entry.countdown.saturating_sub(50));
            self.stream.write_all(&self.block.pack()).await.unwrap();
        }
    }

    /// The next answer.
    async fn answer(&mut self) -> [u8; ANSWER_BYTES] {
        let mut answer = [0; ANSWER_BYTES];
        self.stream.read_exact(&mut answer).await.unwrap();
        answer
    }

    /// Takes what still comes, to the end.
    async fn end(&mut self) {
        let _ = self.stream.read_to_end(&mut Vec::new()).await;
    }
}

const ROOM: usize = 1 << 20;

async fn now(running: &Running) -> Arc<State> {
    // What was sent is with the hub by then.
    sleep(Duration::from_millis(10)).await;
    Arc::clone(&running.state.borrow())
}

fn closed(state: &State, why: Closed) -> u32 {
    state.counters.closed.get(&why).copied().unwrap_or_default()
}

fn refused(state: &State, why: Refusal) -> u32 {
    state.desk.counts.refused.get(&why).copied().unwrap_or_default()
}

#[tokio::test(start_paused = true)]
async fn the_first_answer_comes_after_a_quarter_of_a_second_and_the_others_every_half() {
    let running = start_without_camera(settings()).await;
    let began = Instant::now();
    let mut old = Old::connect(&running, 1, ROOM).await;
    for count in 0..20u64 {
        let answer = old.answer().await;
        assert_eq!(began.elapsed().as_millis() as u64, 250 + 500 * count);
        assert_eq!(answer[1000..], [3, 0, 0, 0]);
        // Late by a while, which moves nothing.
        sleep(Duration::from_millis(100)).await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_block_in_pieces_claims_the_charge_and_its_command_runs_once() {
    let running = start_without_camera(settings()).await;
    let mut old = Old::connect(&running, 2, ROOM).await;
    for piece in old.block.pack().chunks(7) {
        old.stream.write_all(piece).await.unwrap();
        sleep(Duration::from_millis(1)).await;
    }
    let state = now(&running).await;
    assert_eq!(state.in_charge().map(|lease| lease.computer), Some(FlightComputer(2)));
    assert_eq!(state.trigger().map(|trigger| trigger.0), Some(3));
    old.give("solver_general", &[1.0, 7.5]);
    old.fly(1).await;
    assert_eq!(now(&running).await.desk.counts.accepted, 0, "announced, not confirmed");
    old.fly(10).await;
    let state = now(&running).await;
    assert_eq!((state.desk.counts.accepted, state.settings.solver.timeout_s), (1, 7.5));
    let stages: Vec<_> = state.desk.replies.due(FlightComputer(1)).map(|reply| reply.stage).collect();
    assert_eq!(stages, [Stage::Accepted, Stage::Completed]);
    // Out of its range, and a block of zeros.
    old.give("solver_general", &[1.0, 7000.0]);
    old.fly(3).await;
    let truth = old.block.commands;
    old.block.commands = [Entry::default(); COMMANDS];
    old.fly(1).await;
    old.block.commands = truth;
    old.fly(3).await;
    let state = now(&running).await;
    assert_eq!((state.desk.counts.accepted, refused(&state, Refusal::OutOfRange), refused(&state, Refusal::Dialect)), (1, 1, 1));
}

#[tokio::test(start_paused = true)]
async fn a_hazardous_command_arms_and_the_same_again_fires() {
    let running = start_without_camera(settings()).await;
    let mut old = Old::connect(&running, 1, ROOM).await;
    old.fly(2).await;
    old.give("quit", &[]);
    old.fly(4).await;
    let state = now(&running).await;
    assert!(state.desk.armed(running.clock.uptime()).is_some() && state.ending.is_none());
    // Too late: it arms anew.
    sleep(Duration::from_secs(10)).await;
    old.fly(6).await;
    old.give("quit", &[]);
    old.fly(4).await;
    assert!(now(&running).await.ending.is_none());
    old.give("quit", &[]);
    old.fly(2).await;
    assert_eq!(now(&running).await.ending, Some(Ending::Commanded));
}

#[tokio::test(start_paused = true)]
async fn gyro_rates_are_taken_with_their_command_and_what_cannot_be_is_refused() {
    let running = start_without_camera(settings()).await;
    let mut old = Old::connect(&running, 1, ROOM).await;
    let exposing = |index: usize| if (10..22).contains(&index) { 0 } else { -1 };
    let steps = (0..22).map(|index| Step { exposure: exposing(index), az: 1e-3, el: -2e-3 }).collect();
    let recorded = Recorded { counter_fcp: 3, counter_stars: 0, elevation: 0.7, steps };
    old.block.motion = Some(recorded.clone());
    old.fly(3).await;
    let of =
        |state: &State| state.motions.of(&Stamp { image: ImageCounter(0), trigger: Some(TriggerCounter(3)), ..Stamp::default() });
    assert!(of(&*now(&running).await).is_none(), "taken without the command");
    old.give("motion_psf", &[1.0, 0.0, 4.6e-5]);
    old.fly(3).await;
    let state = now(&running).await;
    let motion = of(&state).expect("not taken");
    let [(start, length)] = motion.exposures[..] else { panic!("{:?}", motion.exposures) };
    assert!((start - 10.0 / 100.16).abs() < 1e-6 && (length - 12.0 / 100.16).abs() < 1e-6);
    // The turn in elevation alone would be 2 mrad/s for the exposure.
    let turn = motion.track().turn_at(start + length).norm();
    assert!((turn / (length * 1e-3_f64.hypot(2e-3)) - 1.0).abs() < 1e-3, "{turn}");
    // Of an image that is not there yet, with a rate that is none, and by a command that turns it off.
    for (motion, value, refused) in [
        (Recorded { counter_stars: 9, ..recorded.clone() }, 1.0, 1),
        (Recorded { elevation: f64::NAN, ..recorded.clone() }, 1.0, 2),
        (recorded, 0.0, 2),
    ] {
        old.block.motion = Some(motion);
        old.give("motion_psf", &[value, 0.0, 4.6e-5]);
        old.fly(3).await;
        assert_eq!(now(&running).await.motions.refused, refused);
    }
    assert!(!now(&running).await.settings.solver.motion.enabled);
}

#[tokio::test(start_paused = true)]
async fn a_computer_of_old_and_a_new_one_share_one_lease() {
    let running = start_without_camera(settings()).await;
    let mut new = Peer::attach(&running, ROOM).await.greet(1).await;
    new.status(claim()).await;
    let mut old = Old::connect(&running, 2, ROOM).await;
    old.fly(1).await;
    old.give("solver_general", &[1.0, 7.5]);
    for _ in 0..3 {
        new.status(claim()).await;
        old.fly(1).await;
    }
    let state = now(&running).await;
    assert_eq!(state.in_charge().map(|lease| lease.computer), Some(FlightComputer(1)));
    assert_eq!((state.desk.counts.accepted, refused(&state, Refusal::NotInCharge)), (0, 1));
    // The new one withdraws; what was refused stays so, and what comes now runs.
    new.status(Status::default()).await;
    old.fly(4).await;
    assert_eq!(now(&running).await.desk.counts.accepted, 0);
    old.give("solver_general", &[1.0, 8.5]);
    old.fly(3).await;
    let state = now(&running).await;
    assert_eq!((state.desk.counts.accepted, state.settings.solver.timeout_s), (1, 8.5));
    let update = new.update_where(|update| update.control.replies_count > 2).await;
    assert_eq!(update.authority.in_charge_id.get(), Some(&2));
}

#[tokio::test(start_paused = true)]
async fn where_a_key_is_required_nothing_of_the_dialect_runs() {
    let directory = tempfile::tempdir().unwrap();
    let keys = [1, 2].map(|number: u8| {
        use std::os::unix::fs::OpenOptionsExt;
        let path = directory.path().join(format!("key{number}"));
        let mut file = std::fs::OpenOptions::new().create_new(true).write(true).mode(0o600).open(&path).unwrap();
        std::io::Write::write_all(&mut file, "5a".repeat(32).as_bytes()).unwrap();
        path.display().to_string()
    });
    let mut strict: Settings = settings();
    strict.commands.require_authentication = true;
    [strict.commands.key_file_1, strict.commands.key_file_2] = keys;
    let running = start_without_camera(strict).await;
    let mut old = Old::connect(&running, 1, ROOM).await;
    old.fly(1).await;
    old.give("solver_general", &[1.0, 7.5]);
    old.fly(3).await;
    let state = now(&running).await;
    assert_eq!((state.desk.counts.accepted, refused(&state, Refusal::NotAuthentic)), (0, 1));
}

#[tokio::test(start_paused = true)]
async fn another_version_ends_the_connection_and_strangers_get_none() {
    let running = start_without_camera(settings()).await;
    let mut old = Old::connect(&running, 1, ROOM).await;
    let mut bytes = old.block.pack();
    bytes[BLOCK_BYTES - 4] = 4;
    old.stream.write_all(&bytes).await.unwrap();
    old.end().await;
    let mut stranger = Old::connect(&running, 3, ROOM).await;
    stranger.end().await;
    let state = now(&running).await;
    assert_eq!((closed(&state, Closed::BadMessage), closed(&state, Closed::AddressNotAllowed)), (1, 1));
    assert!(state.peers.is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_silent_computer_is_kept_while_it_reads_and_closed_when_it_does_not() {
    let running = start_without_camera(settings()).await;
    let mut reads = Old::connect(&running, 1, ROOM).await;
    let mut reads_not = Old::connect(&running, 2, 2000).await;
    for _ in 0..600 {
        reads.answer().await;
    }
    let state = now(&running).await;
    assert_eq!(state.peers.iter().map(|peer| peer.computer.0).collect::<Vec<_>>(), [1]);
    assert_eq!(closed(&state, Closed::NotReading), 1);
    reads_not.end().await;
    // A block that is begun must be finished.
    reads.stream.write_all(&[1; 100]).await.unwrap();
    reads.end().await;
    assert_eq!(closed(&*now(&running).await, Closed::Silent), 1);
}

#[tokio::test(start_paused = true)]
async fn a_newer_connection_of_the_same_computer_replaces_the_older() {
    let running = start_without_camera(settings()).await;
    let mut first = Old::connect(&running, 1, ROOM).await;
    first.fly(2).await;
    let mut second = Old::connect(&running, 1, ROOM).await;
    first.end().await;
    // Its first block runs nothing, with whatever countdown it comes.
    second.give("solver_general", &[1.0, 7.5]);
    second.fly(3).await;
    let state = now(&running).await;
    assert_eq!((state.peers.len(), closed(&state, Closed::Replaced), state.desk.counts.accepted), (1, 1, 0));
    second.answer().await;
}
