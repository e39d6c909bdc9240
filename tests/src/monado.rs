//! Runs a command on Monado by `tools/monado`, and reads what its witnesses wrote: the Vulkan validation layer, OpenXR's
//! core_validation layer, and the list of OpenXR calls.

use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Which headset Monado is to have.
#[derive(Clone, Copy, Debug)]
pub enum Driver {
    /// Moves by a fixed formula.
    Simulated,
    /// Posed by a script on this TCP port.
    Remote(u16),
}

/// A command that runs on a Monado of its own; stopped, with that Monado, when dropped.
#[derive(Debug)]
pub struct Run {
    child: Child,
    /// Where stdout, stderr and the witnesses' messages are.
    folder: PathBuf,
}

/// A port that was free a moment ago.
///
/// # Panics
/// When the machine has no free port.
#[must_use]
pub fn free_port() -> u16 {
    let listener = TcpListener::bind(("0.0.0.0", 0)).expect("a free port");
    listener.local_addr().expect("a bound listener has an address").port()
}

/// Whether Monado is there; where not, the test says that it is skipped.
///
/// # Panics
/// When `VERGENCE_REQUIRE` names `openxr` and Monado is not there.
#[must_use]
pub fn available() -> bool {
    let there = Command::new(script()).arg("where").stdout(Stdio::null()).stderr(Stdio::null()).status();
    let there = there.is_ok_and(|status| status.success());
    if !there {
        crate::skip("openxr", "Monado is not set up: tools/setup test");
    }
    there
}

fn script() -> PathBuf {
    crate::checkout().join("tools/monado")
}

impl Run {
    /// Starts `command` on Monado under both validation layers; what it and they write goes to `folder`.
    ///
    /// # Panics
    /// When `tools/monado` cannot be started.
    #[must_use]
    pub fn start(driver: Driver, folder: &Path, command: &[&std::ffi::OsStr]) -> Run {
        let file =
            |name| std::fs::File::create(folder.join(name)).expect("the test's own folder is writable");
        let mut run = Command::new(script());
        run.args(["run", "--layers", "--messages"]).arg(folder);
        match driver {
            Driver::Simulated => run.args(["--driver", "simulated"]),
            Driver::Remote(port) => run.args(["--driver", "remote", "--port", &port.to_string()]),
        };
        run.arg("--")
            .args(command)
            .stdin(Stdio::null())
            .stdout(file("stdout.txt"))
            .stderr(file("stderr.txt"));
        let child = run.spawn().expect("tools/monado runs");
        Run { child, folder: folder.to_owned() }
    }

    /// Whether the command is still running.
    pub fn running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Waits for the end of the command.
    ///
    /// # Panics
    /// When it takes longer than `patience`; it is stopped then.
    pub fn wait(&mut self, patience: Duration) -> ExitStatus {
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("the child can be waited for") {
                return status;
            }
            assert!(started.elapsed() < patience, "no end after {patience:?}\n{}", self.story());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// What the command printed on stdout.
    #[must_use]
    pub fn stdout(&self) -> String {
        self.read("stdout.txt")
    }

    /// The OpenXR calls that reached the runtime, as the api_dump layer wrote them.
    #[must_use]
    pub fn calls(&self) -> String {
        self.read("calls.txt")
    }

    /// The ends of everything that was written, for a failure message.
    #[must_use]
    pub fn story(&self) -> String {
        let tail = |name: &str| {
            let text = self.read(name);
            let lines: Vec<&str> = text.lines().collect();
            format!("--- {name}\n{}\n", lines[lines.len().saturating_sub(25)..].join("\n"))
        };
        ["stdout.txt", "stderr.txt", "vulkan.txt", "openxr.txt", "monado.log"].map(tail).concat()
    }

    /// Every complaint of Vulkan validation (error, warning, performance, synchronization) and of OpenXR's core_validation.
    ///
    /// # Panics
    /// When a layer was not active at all: its silence would mean nothing.
    #[must_use]
    pub fn complaints(&self) -> Vec<String> {
        let vulkan = self.read("vulkan.txt");
        assert!(
            vulkan.contains("Khronos Validation Layer Active"),
            "Vulkan validation was off\n{}",
            self.story()
        );
        assert!(
            vulkan.contains("VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT"),
            "synchronization validation was off\n{vulkan}"
        );
        let openxr = self.read("openxr.txt");
        assert!(
            openxr.contains("Core Validation Layer is initialized"),
            "core_validation was off\n{}",
            self.story()
        );
        vulkan_complaints(&vulkan).into_iter().chain(openxr_complaints(&openxr)).collect()
    }

    fn read(&self, name: &str) -> String {
        let bytes = std::fs::read(self.folder.join(name)).unwrap_or_default();
        String::from_utf8_lossy(&bytes).into_owned()
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // The namespaces of the run end with the script, and with them everything that it started.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Messages start with `Validation KIND: [ NAME ]`; the layer's own news is of the kind `Information`.
fn vulkan_complaints(text: &str) -> Vec<String> {
    let mut messages: Vec<String> = Vec::new();
    for line in text.lines() {
        if line.starts_with("Validation ") {
            messages.push(String::new());
        }
        if let Some(message) = messages.last_mut() {
            message.push_str(line);
            message.push('\n');
        }
    }
    messages.retain(|message| !message.starts_with("Validation Information:"));
    messages
}

/// One line each, `[TIME][LEVEL | …`; the level `VALID_DEBUG` tells of the layer's own start and end.
fn openxr_complaints(text: &str) -> Vec<String> {
    text.lines()
        .filter(|line| line.contains("VALID_") && !line.contains("[VALID_DEBUG "))
        .map(String::from)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complaints_are_told_from_news() {
        let vulkan = "Validation Information: [ A ] | 1\nvkCreateInstance(): Khronos Validation Layer Active:\n\n\
                      Validation Error: [ SYNC-HAZARD-WRITE-AFTER-READ ] | 2\nvkQueueSubmit2(): hazard\n\nObjects: 1\n";
        let found = vulkan_complaints(vulkan);
        assert_eq!(found.len(), 1);
        assert!(found[0].contains("hazard") && found[0].contains("Objects"));

        let openxr = "[2026-01-01 00:00:00][VALID_DEBUG | VUID-A | xrCreateApiLayerInstance] : initialized\n\
                      [2026-01-01 00:00:00][VALID_ERROR | VUID-B | xrEndFrame] : wrong\n";
        assert_eq!(openxr_complaints(openxr).len(), 1);
    }
}
