//! The Python client against a camera made of the wire room and a plain socket.

use crate::{frame, proto, same, samples};
use serde_json::Value;
use stars::wire::{Hello, Message, PROTOCOL_CURRENT, Reader, Refusal, Refuse, Role};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

/// Starts a client against a listener, lets `camera` serve its first connection, and gives what the client printed.
fn client(program: Command, arguments: &[&str], camera: impl FnOnce(&mut TcpStream, &Child)) -> Output {
    let mut program = program;
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    program.args(["--connect", &address]).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child =
        program.spawn().unwrap_or_else(|error| panic!("{program:?} is needed to check proto/ and does not start: {error}"));
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    camera(&mut stream, &child);
    child.wait_with_output().unwrap()
}

fn python() -> Command {
    let mut command = Command::new("python3");
    command.arg(proto("stars_client.py"));
    command
}

fn stars_fcp() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stars"));
    command.arg("fcp");
    command
}

/// The camera's part: hellos, the first status, then a solved and an unsolved image in pieces, as a network would.
fn serve_two_updates(stream: &mut TcpStream) {
    let (mut reader, mut buffer) = (Reader::default(), bytes::BytesMut::new());
    let Message::Hello(theirs) = receive(stream, &mut reader, &mut buffer) else { panic!("no hello") };
    let ours = Hello::new(Role::Camera, 1, "xsc0", 77, None);
    assert_eq!(ours.agree(&theirs), Ok(PROTOCOL_CURRENT));
    assert_eq!(theirs.id, 2);
    stream.write_all(&frame(&Message::Hello(Box::new(ours)))).unwrap();
    let Message::Status(status) = receive(stream, &mut reader, &mut buffer) else { panic!("no status") };
    assert!(status.claims_charge && status.uptime_s >= 0.0 && status.sequence.get() == 0);
    assert!((status.observer().unwrap().latitude.to_degrees() + 77.5).abs() < 1e-9);
    let bytes = [frame(&sample("update_solved")), frame(&sample("update_unsolved"))].concat();
    bytes.chunks(100).for_each(|piece| stream.write_all(piece).unwrap());
}

fn lines(output: &Output) -> Vec<Value> {
    String::from_utf8_lossy(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn kinds(lines: &[Value]) -> Vec<&str> {
    lines.iter().map(|line| line["kind"].as_str().unwrap()).collect()
}

fn assert_carries(line: &Value, message: &Message) {
    for (name, value) in message.json().unwrap() {
        assert!(same(&line[&name], &value), "{name}: {}, not {value}", line[&name]);
    }
    assert!(line["t_s"].as_f64().unwrap() >= 0.0);
}

const OPTIONS: [&str; 8] =
    ["--id", "2", "--in-charge", "--updates", "2", "--json", "--latitude-deg=-77.5", "--sidereal-time-h=8.25"];

/// The next message of the client.
fn receive(stream: &mut TcpStream, reader: &mut Reader, buffer: &mut bytes::BytesMut) -> Message {
    loop {
        if let Some(message) = reader.next(buffer).unwrap() {
            return message;
        }
        let mut bytes = [0; 4096];
        let count = stream.read(&mut bytes).unwrap();
        assert!(count > 0, "the client closed the connection");
        buffer.extend_from_slice(&bytes[..count]);
    }
}

fn sample(name: &str) -> Message {
    samples::all().into_iter().find(|(other, _)| *other == name).unwrap().1
}

#[test]
fn the_python_client_shakes_hands_sends_its_status_and_prints_updates() {
    let output = client(python(), &OPTIONS, |stream, _| serve_two_updates(stream));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = lines(&output);
    assert_eq!(kinds(&lines), ["connected", "update", "command", "command", "update"]);
    assert_carries(&lines[1], &sample("update_solved"));
    assert_carries(&lines[4], &sample("update_unsolved"));
}

#[test]
fn stars_fcp_prints_every_variable_by_its_name_and_ends_after_the_updates_wanted() {
    let output = client(stars_fcp(), &OPTIONS, |stream, _| serve_two_updates(stream));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = lines(&output);
    assert_eq!(kinds(&lines), ["connected", "update", "command", "command", "update", "closed"]);
    assert_eq!(lines[0]["name"], "xsc0");
    assert_carries(&lines[1], &sample("update_solved"));
    assert_carries(&lines[4], &sample("update_unsolved"));
    assert!(lines[1]["interval_s"].is_null() && lines[4]["interval_s"].as_f64().unwrap() >= 0.0);
    assert_eq!(lines[5]["reason"], "enough updates");
}

#[test]
fn stars_fcp_in_words_says_what_was_solved_and_why_not() {
    let words: Vec<_> = OPTIONS.into_iter().filter(|option| *option != "--json").collect();
    let output = client(stars_fcp(), &words, |stream, _| serve_two_updates(stream));
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("image 70009 solved  ra 136.56460° dec -43.96782°"), "{text}");
    assert!(text.contains("image 70009 undecided: 4 matched, 5 needed"), "{text}");
    assert_eq!(text.matches("simulated").count(), 2, "{text}");
}

#[test]
fn stars_fcp_ends_cleanly_when_interrupted() {
    let output = client(stars_fcp(), &["--id", "2", "--json"], |stream, child| {
        let (mut reader, mut buffer) = (Reader::default(), bytes::BytesMut::new());
        receive(stream, &mut reader, &mut buffer);
        stream.write_all(&frame(&Message::Hello(Box::new(Hello::new(Role::Camera, 1, "xsc0", 77, None))))).unwrap();
        // Its status shows that it runs.
        receive(stream, &mut reader, &mut buffer);
        let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        assert!(killed.success());
    });
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = lines(&output);
    assert_eq!(kinds(&lines), ["connected", "closed"]);
    assert_eq!(lines[1]["reason"], "interrupted");
}

#[test]
fn stars_fcp_without_a_camera_gives_up_where_updates_were_wanted() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let output = stars_fcp().args(["--connect", &free, "--updates", "1", "--retry", "10ms"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(String::from_utf8_lossy(&output.stderr).matches("no connection").count(), 4);
}

fn refuse_and_close(stream: &mut TcpStream) {
    let refuse = Refuse::new(Refusal::NoCommonVersion, "you speak 1 to 1");
    stream.write_all(&frame(&Message::Refuse(Box::new(refuse)))).unwrap();
    // Read what it still sends, so that closing does not reset the connection under the refusal.
    let _ = stream.shutdown(std::net::Shutdown::Write);
    let _ = stream.read_to_end(&mut Vec::new());
}

#[test]
fn both_clients_say_why_they_were_refused() {
    let python = client(python(), &["--id", "1", "--updates", "1", "--json", "--once"], |stream, _| refuse_and_close(stream));
    let ours = client(stars_fcp(), &["--id", "1", "--duration", "1s", "--json"], |stream, _| refuse_and_close(stream));
    assert_eq!((python.status.code(), ours.status.code()), (Some(1), Some(0)));
    for output in [python, ours] {
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(text.contains("\"closed\"") && text.contains("no_common_version"), "{text}");
    }
}

/// So often it is looked whether the camera is there: for a minute at least.
const ATTEMPTS: u32 = 1200;

/// `stars run` with a quick simulated lens, no camera, on a port of its own; it ends with the test.
struct Camera {
    child: Child,
    port: u16,
    _room: tempfile::TempDir,
}

impl Camera {
    fn start(set: &[&str]) -> Self {
        let room = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut run = Command::new(env!("CARGO_BIN_EXE_stars"));
        run.current_dir(&room).args(["run", "--set", "camera.kind=none", "--set", "lens.simulated.speedup=20"]);
        run.args(["--set", "catalog.cache_directory=cache", "--set", &format!("network.listen=127.0.0.1:{port}")]);
        for one in set {
            run.args(["--set", one]);
        }
        let child = run.spawn().unwrap();
        let listens = (0..ATTEMPTS).any(|_| {
            std::thread::sleep(Duration::from_millis(50));
            TcpStream::connect(("127.0.0.1", port)).is_ok()
        });
        assert!(listens, "the camera does not listen");
        // The lens is read once it is found; until then a move is from an unknown position, and refused.
        let address = format!("127.0.0.1:{port}");
        let found = (0..ATTEMPTS).any(|_| {
            let look = stars_fcp().args(["--connect", &address, "--id", "2", "--updates", "2", "--json"]).output().unwrap();
            lines(&look).iter().any(|line| line["focus_counts_known"] == true)
        });
        assert!(found, "the lens is not found");
        Self { child, port, _room: room }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The stages that a client printed for commands of this name or code.
fn stages_of(lines: &[Value]) -> Vec<String> {
    let commands = lines.iter().filter(|line| line["kind"] == "command");
    commands.map(|line| line["stage"].as_str().unwrap().to_owned()).collect()
}

const DONE: [&str; 3] = ["accepted", "started", "completed"];

/// The worked example in C, built in a directory.
fn example_in_c(room: &std::path::Path) -> std::path::PathBuf {
    let program = room.join("example");
    let include = format!("-I{}", proto("").display());
    let arguments = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", &include, "-o", program.to_str().unwrap()];
    crate::run("gcc", &[&arguments[..], &[proto("example.c").to_str().unwrap()]].concat());
    program
}

#[test]
fn both_worked_examples_print_solutions_of_the_simulated_sky_and_command_it() {
    let camera = Camera::start(&["camera.kind=sky", "camera.period_s=0.5", "simulate.kind=night"]);
    let room = tempfile::tempdir().unwrap();
    let c = |arguments: &[&str]| {
        Command::new(example_in_c(room.path())).arg(camera.port.to_string()).args(arguments).output().unwrap()
    };
    let python = |arguments: &[&str]| {
        let mut command = Command::new("python3");
        command.arg(proto("example.py")).arg(format!("127.0.0.1:{}", camera.port)).args(arguments).output().unwrap()
    };
    let solutions = |output: &Output| {
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
        said.lines().filter(|line| line.starts_with("image ") && line.contains(" ra ") && line.contains("arcsec^2")).count()
    };
    assert_eq!([solutions(&c(&[])), solutions(&python(&[]))], [5, 5]);
    let commanded = python(&["lens.set_focus 2950"]);
    let said = String::from_utf8_lossy(&commanded.stdout).into_owned();
    assert!(commanded.status.success() && said.contains("completed: focus at 2950 counts"), "{said}");
    let refused = python(&["service.quit"]);
    assert_eq!(refused.status.code(), Some(1), "{}", String::from_utf8_lossy(&refused.stdout));
}

#[test]
fn a_c_program_commands_the_running_service_and_reads_the_stages() {
    let camera = Camera::start(&[]);
    let room = tempfile::tempdir().unwrap();
    let program = example_in_c(room.path());
    let output = Command::new(&program).args([&camera.port.to_string(), "23", "2900"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{:?}: {said}", output.status);
    let stages: Vec<&str> = said.lines().filter(|line| line.starts_with("command")).collect();
    assert_eq!(stages.len(), 3, "{said}");
    assert!(stages[0].starts_with("command 23 stage 1") && stages[1].starts_with("command 23 stage 2"), "{said}");
    assert!(stages[2].starts_with("command 23 stage 3: focus at 2900 counts"), "{said}");
}

#[test]
fn both_other_clients_command_the_running_service_with_a_key() {
    let room = tempfile::tempdir().unwrap();
    let (key, wrong) = (room.path().join("key"), room.path().join("wrong"));
    for (path, digits) in [(&key, "5a"), (&wrong, "5b")] {
        std::fs::write(path, digits.repeat(32)).unwrap();
        std::fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    }
    let key_file = format!("commands.key_file_1={}", key.display());
    let camera = Camera::start(&["commands.require_authentication=true", &key_file]);
    let address = format!("127.0.0.1:{}", camera.port);
    for (client, number) in [(python as fn() -> Command, "2901"), (stars_fcp, "2902")] {
        let send = |key: &std::path::Path, commands: &[&str]| {
            let mut command = client();
            command.args(["--connect", &address, "--id", "1", "--in-charge", "--json", "--key-file", key.to_str().unwrap()]);
            for text in commands {
                command.args(["--send", text]);
            }
            let output = command.output().unwrap();
            // Replies that nobody acknowledged before its connection ended come again: they are others' by now.
            let ours = |line: &Value| line["name"].as_str().is_none_or(|name| commands.iter().any(|text| text.starts_with(name)));
            let said = lines(&output).into_iter().filter(|line| line["kind"] != "command" || ours(line));
            (output.status.code(), said.collect::<Vec<_>>())
        };
        let focus = format!("lens.set_focus {number}");
        let (status, said) = send(&key, &["lens.get_focus", &focus]);
        assert_eq!((status, stages_of(&said)), (Some(0), [DONE, DONE].concat().iter().map(|s| (*s).to_owned()).collect()));
        let (status, said) = send(&wrong, &["lens.stop"]);
        assert_eq!(status, Some(1), "{said:?}");
        // The block is refused as a whole, and the command in it never answered by its name.
        let refused = |line: &Value| line["stage"] == "rejected" || line["stage"].is_null();
        assert!(said.iter().all(|line| line["kind"] != "command" || refused(line)), "{said:?}");
        let (status, said) = send(&key, &["service.quit"]);
        assert_eq!((status, stages_of(&said)), (Some(1), vec!["rejected".to_owned()]));
    }
}

#[test]
fn a_command_to_quit_is_answered_before_the_program_ends_and_a_camera_that_is_gone_is_given_up() {
    let mut camera = Camera::start(&[]);
    let fcp = |commands: &[&str]| {
        let mut command = stars_fcp();
        command.args(["--connect", &format!("127.0.0.1:{}", camera.port), "--in-charge", "--json", "--retry", "200ms"]);
        for text in commands {
            command.args(["--send", text]);
        }
        let output = command.output().unwrap();
        (output.status.code(), stages_of(&lines(&output)))
    };
    assert_eq!(fcp(&["service.quit"]), (Some(1), vec!["rejected".to_owned()]));
    let (status, stages) = fcp(&["arm service.quit", "fire service.quit"]);
    assert_eq!((status, stages), (Some(0), ["accepted", "completed"].repeat(2).iter().map(|s| (*s).to_owned()).collect()));
    assert_eq!(fcp(&["lens.stop"]), (Some(1), Vec::new()), "nobody is there any more");
    assert!(camera.child.wait().unwrap().success());
}

/// The whole way of a focus: from a command of a flight computer by the lens's port, rendered frames and their solutions to the lens at rest
/// in the best focus, where the sky is sharp.
#[test]
fn a_command_to_focus_ends_in_the_best_focus_of_the_simulated_sky() {
    let camera = Camera::start(&["camera.kind=sky", "camera.period_s=0.25", "simulate.best_focus_counts=2950"]);
    let mut command = stars_fcp();
    command.args(["--connect", &format!("127.0.0.1:{}", camera.port), "--in-charge", "--json"]);
    let output = command.args(["--send", "arm focus.run", "--send", "fire focus.run"]).output().unwrap();
    let said = lines(&output);
    let ended = said.iter().rfind(|line| line["kind"] == "command").unwrap();
    assert_eq!(ended["stage"], "completed", "{ended}");
    let words = ended["words"].as_str().unwrap();
    let best: f64 = words.strip_prefix("best ").and_then(|rest| rest.split(' ').next()).unwrap().parse().unwrap();
    assert!((best - 2950.0).abs() < 10.0, "{words}");
    let last = said.iter().rfind(|line| line["kind"] == "update").unwrap();
    assert!((last["focus_counts"].as_f64().unwrap() - 2950.0).abs() < 20.0, "{}", last["focus_counts"]);
}

/// So many bytes have come, or more.
fn has(path: &std::path::Path, bytes: u64) -> bool {
    std::fs::metadata(path).is_ok_and(|meta| meta.len() >= bytes)
}

/// An image that the Python client begins, is killed over, and goes on with; and a view of the same, which the Python decoder finds exact.
#[test]
fn the_python_client_fetches_an_image_after_a_break_and_its_view() {
    // A small picture, as the decoder takes its time.
    let set = [
        "camera.kind=sky",
        "camera.width_px=384",
        "camera.height_px=256",
        "camera.period_s=3600",
        "camera.startup_delay_s=0",
        "record.reserve_gib=0",
        "images.rate_bytes_s=1e6",
    ];
    let camera = Camera::start(&set);
    let room = tempfile::tempdir().unwrap();
    let (out, part, view) = (room.path().join("a.fits"), room.path().join("a.fits.part"), room.path().join("a.view"));
    let fetch = |what: &str, out: &std::path::Path, more: &[&str]| {
        let mut command = python();
        command.args(["--connect", &format!("127.0.0.1:{}", camera.port), "--json", "--once", "--fetch", what, "--out"]);
        command.arg(out).args(more).stdout(Stdio::piped());
        command
    };
    let none = fetch("7", &out, &[]).output().unwrap();
    assert_eq!(none.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&none.stdout).contains("refused: never_was"), "{none:?}");
    // Slowly, so that it is under way when it is killed.
    let mut killed = loop {
        let mut child = fetch("newest", &out, &["--rate", "100000"]).spawn().unwrap();
        let begun = (0..ATTEMPTS).any(|_| {
            std::thread::sleep(Duration::from_millis(50));
            has(&part, 20_000) || child.try_wait().unwrap().is_some()
        });
        assert!(begun, "nothing comes");
        if has(&part, 20_000) {
            break child;
        }
        // No image has been kept yet.
    };
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(has(&part, 20_000) && !out.exists());
    let resumed = fetch("newest", &out, &[]).output().unwrap();
    assert!(resumed.status.success(), "{}", String::from_utf8_lossy(&resumed.stdout));
    let records = camera._room.path().join("records/images");
    let day = std::fs::read_dir(records).unwrap().next().unwrap().unwrap().path();
    let kept = std::fs::read(std::fs::read_dir(day).unwrap().next().unwrap().unwrap().path()).unwrap();
    assert!(std::fs::read(&out).unwrap() == kept, "not the file that is kept");
    assert!(!part.exists());
    assert!(fetch("0", &view, &["--view"]).output().unwrap().status.success());
    let decoder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/view.py");
    let said = crate::run("python3", &[decoder.to_str().unwrap(), view.to_str().unwrap()]);
    assert!(said.contains("\"exact\": true"), "{said}");
}
