//! Fingers on a touch screen, recorded as users do it: an X server with a touch screen device of its own (its driver `inputtest`, whose
//! device is a socket), the window of `vergence record --device desktop`, the log.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use vergence_tests::{skip, vergence};

/// Nothing here takes longer where it works, whatever the load.
const PATIENCE: Duration = Duration::from_secs(120);
const MODULES: &str = "/usr/lib/xorg/modules";
/// Of the screen, pixels; the device counts to 65,535 along each side.
const SCREEN: [f64; 2] = [800.0, 600.0];
const MOST: f64 = 65_535.0;

/// A process that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn configuration(socket: &Path) -> String {
    format!(
        "Section \"ServerLayout\"\n Identifier \"all\"\n Screen \"screen\"\n InputDevice \"touch\" \"SendCoreEvents\"\nEndSection\n\
         Section \"ServerFlags\"\n Option \"AutoAddDevices\" \"false\"\n Option \"DontVTSwitch\" \"true\"\nEndSection\n\
         Section \"InputDevice\"\n Identifier \"touch\"\n Driver \"inputtest\"\n Option \"SocketPath\" \"{}\"\n \
         Option \"DeviceType\" \"Touch\"\n Option \"TouchCount\" \"10\"\nEndSection\n\
         Section \"Device\"\n Identifier \"none\"\n Driver \"dummy\"\n VideoRam 16384\nEndSection\n\
         Section \"Monitor\"\n Identifier \"monitor\"\n HorizSync 5-200\n VertRefresh 5-200\nEndSection\n\
         Section \"Screen\"\n Identifier \"screen\"\n Device \"none\"\n Monitor \"monitor\"\n DefaultDepth 24\n \
         SubSection \"Display\"\n  Depth 24\n  Virtual {} {}\n EndSubSection\nEndSection\n",
        socket.display(),
        SCREEN[0],
        SCREEN[1]
    )
}

/// The server, and its display; why not, where there is none.
fn server(folder: &Path, socket: &Path) -> Result<(Running, String), String> {
    for module in ["input/inputtest_drv.so", "drivers/dummy_drv.so"] {
        if !Path::new(MODULES).join(module).exists() {
            return Err(format!("no {MODULES}/{module}"));
        }
    }
    let configured = folder.join("x.conf");
    std::fs::write(&configured, configuration(socket)).map_err(|error| error.to_string())?;
    let mut server = Command::new("/usr/lib/xorg/Xorg")
        .args(["-displayfd", "1", "-noreset", "-novtswitch", "-sharevts", "-nolisten", "tcp", "-logfile"])
        .arg(folder.join("x.log"))
        .arg("-config")
        .arg(configured)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(|error| format!("/usr/lib/xorg/Xorg: {error}"))?;
    let (mut line, out) = (String::new(), server.stdout.take());
    let server = Running(server);
    let read = out.map(|out| BufReader::new(out).read_line(&mut line));
    match read {
        Some(Ok(1..)) => Ok((server, format!(":{}", line.trim()))),
        _ => {
            let said = std::fs::read_to_string(folder.join("x.log")).unwrap_or_default();
            let why = said.lines().rfind(|line| line.contains("(EE)")).unwrap_or("it said nothing");
            Err(format!("the X server does not start: {why}"))
        }
    }
}

/// The other end of the touch screen: messages of a length, a kind, and what belongs to it.
struct Fingers(UnixStream);

impl Fingers {
    fn new(socket: &Path) -> std::io::Result<Self> {
        let mut fingers = Self(UnixStream::connect(socket)?);
        fingers.0.set_read_timeout(Some(PATIENCE))?;
        // Version 1.1 of the protocol, which the server answers with its own.
        fingers.send(0, &[1, 0, 1, 0])?;
        fingers.0.read_exact(&mut [0; 12])?;
        Ok(fingers)
    }

    fn send(&mut self, kind: u32, rest: &[u8]) -> std::io::Result<()> {
        let mut message = (rest.len() as u32 + 8).to_le_bytes().to_vec();
        message.extend(kind.to_le_bytes());
        message.extend(rest);
        self.0.write_all(&message)
    }

    /// Begin (18), update (19) or end (20) of a contact, at a place of the screen in pixels; returns when the server has it.
    fn touch(&mut self, contact: u32, what: u32, place: [f64; 2]) -> std::io::Result<()> {
        let mut rest: Vec<u8> = [contact, what, 0].into_iter().flat_map(u32::to_le_bytes).collect();
        // Which of 64 axes are given, and all of them twice.
        rest.extend([0b11, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        for axis in 0..128 {
            let value = if axis < 2 { place[axis] / SCREEN[axis] * MOST } else { 0.0 };
            rest.extend(value.to_le_bytes());
        }
        self.send(6, &rest)?;
        self.send(1, &[])?;
        self.0.read_exact(&mut [0; 8])
    }
}

fn until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < PATIENCE, "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn fingers_on_a_touch_screen_are_recorded() {
    let folder = tempfile::tempdir().expect("a folder");
    let (socket, log) = (folder.path().join("fingers"), folder.path().join("touch.mcap"));
    let (_server, display) = match server(folder.path(), &socket) {
        Ok(server) => server,
        Err(why) => return skip("touch", &why),
    };
    let xdotool =
        |arguments: &[&str]| Command::new("xdotool").args(arguments).env("DISPLAY", &display).output();
    if xdotool(&["version"]).is_err() {
        return skip("xdotool", "no xdotool");
    }
    let mut record = Command::new(vergence())
        .args(["record", "--device", "desktop"])
        .arg(&log)
        .env("DISPLAY", &display)
        .env_remove("WAYLAND_DISPLAY")
        .stdout(Stdio::null())
        .spawn()
        .map(Running)
        .expect("the tool starts");
    until("a window", || {
        assert!(record.0.try_wait().expect("a process").is_none(), "it ended early");
        let found = xdotool(&["search", "--onlyvisible", "--name", "Vergence: keys"]);
        found.is_ok_and(|output| output.status.success())
    });
    let mut fingers = Fingers::new(&socket).expect("the server listens");
    let all = [
        (1, 18, [100.0, 50.0], "begins"),
        (2, 18, [200.0, 60.0], "begins"),
        (1, 19, [120.0, 70.0], "moves"),
        (2, 20, [200.0, 60.0], "ends"),
        (1, 20, [120.0, 70.0], "ends"),
    ];
    for (contact, what, place, _) in all {
        fingers.touch(contact, what, place).expect("the server takes it");
    }
    let printed = || {
        let replay = Command::new(vergence()).arg("replay").arg(&log).args(["--print", "touch"]).output();
        String::from_utf8(replay.expect("the tool starts").stdout).expect("text")
    };
    // The log is written twice a second.
    until("five touches", || printed().lines().count() >= all.len());
    let id = rustix::process::Pid::from_raw(record.0.id().cast_signed()).expect("a running process");
    rustix::process::kill_process(id, rustix::process::Signal::INT).expect("interrupted");
    assert!(record.0.wait().expect("it ends").success());
    let printed = printed();
    let rows: Vec<Vec<&str>> =
        printed.lines().map(|line| line.split_whitespace().skip(2).collect()).collect();
    assert_eq!(rows.len(), all.len(), "{printed}");
    for (row, (contact, _, place, phase)) in rows.iter().zip(all) {
        assert_eq!(row[..2], [&contact.to_string(), phase], "{printed}");
        for (word, wanted) in row[2..].iter().zip(place) {
            let found: f64 = word.parse().expect("a number");
            // Without a window manager the window begins at the screen's corner. The device counts in whole steps.
            assert!((found - wanted).abs() < 0.1, "{printed}");
        }
    }
}
