//! `vergence doctor`: what this machine has of what Vergence uses, what is missing, and the command that mends it.

use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::Command;

use serde::Serialize;
use vergence_gpu as gpu;
use vergence_xr as xr;

use crate::failure::Failure;

/// Libraries that the window opens at run time, and the Debian package of each.
const WINDOW_LIBRARIES: [(&str, &str); 5] = [
    ("libX11.so.6", "libx11-6"),
    ("libX11-xcb.so.1", "libx11-xcb1"),
    ("libXcursor.so.1", "libxcursor1"),
    ("libXi.so.6", "libxi6"),
    ("libxkbcommon-x11.so.0", "libxkbcommon-x11-0"),
];

/// Says what is there of Vulkan devices, OpenXR runtime and displays, what is missing, and what mends it
#[derive(clap::Args)]
pub struct Args {
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

/// What was found of one thing.
#[derive(Serialize)]
struct Finding {
    topic: &'static str,
    /// Whether it can be used.
    usable: bool,
    /// Whether nothing works without it.
    needed: bool,
    found: Vec<String>,
    /// What is missing, where something is.
    #[serde(skip_serializing_if = "Option::is_none")]
    missing: Option<String>,
    /// The command that mends it.
    #[serde(skip_serializing_if = "Option::is_none")]
    mend: Option<String>,
}

impl Finding {
    fn new(topic: &'static str) -> Self {
        Self { topic, usable: true, needed: false, found: Vec::new(), missing: None, mend: None }
    }

    fn lacks(mut self, missing: impl Into<String>, mend: &str) -> Self {
        self.usable = false;
        self.missing = Some(missing.into());
        self.mend = Some(mend.to_owned());
        self
    }
}

impl Args {
    /// # Errors
    /// When something is missing without which nothing works.
    pub fn run(self) -> Result<(), Failure> {
        let findings = [vulkan(), validation(), openxr(), simulated(), window(), display()];
        if self.json {
            let value = serde_json::json!({ "findings": findings, "usable": usable(&findings) });
            println!("{value:#}");
        } else {
            findings.iter().for_each(print);
        }
        if usable(&findings) {
            return Ok(());
        }
        let missing: Vec<&str> = findings.iter().filter(|f| f.needed && !f.usable).map(|f| f.topic).collect();
        Err(Failure::Work(format!("nothing works without: {}", missing.join(", "))))
    }
}

fn usable(findings: &[Finding]) -> bool {
    findings.iter().all(|finding| finding.usable || !finding.needed)
}

fn print(finding: &Finding) {
    let mark = match (finding.usable, finding.needed) {
        (true, _) => "there",
        (false, true) => "MISSING",
        (false, false) => "not there",
    };
    println!("{:<18} {mark}", finding.topic);
    for line in &finding.found {
        println!("    {line}");
    }
    if let Some(missing) = &finding.missing {
        println!("    {missing}");
    }
    if let Some(mend) = &finding.mend {
        println!("    mend: {mend}");
    }
}

fn vulkan() -> Finding {
    let mut finding = Finding { needed: true, ..Finding::new("Vulkan device") };
    let desc = gpu::InstanceDesc { app_name: "vergence doctor", ..gpu::InstanceDesc::default() };
    let devices = gpu::Instance::new(&desc, None).and_then(|instance| instance.describe_devices());
    match devices {
        Err(error) => finding.lacks(error.to_string(), "tools/setup run"),
        Ok(devices) => {
            let mut suitable = false;
            for device in &devices {
                let head =
                    format!("{} ({}, Vulkan {}, {})", device.name, device.kind, device.vulkan, device.driver);
                suitable |= device.missing.is_empty();
                finding.found.push(match device.missing.as_slice() {
                    [] => head,
                    missing => format!("{head}: cannot be used, lacks {}", missing.join(", ")),
                });
            }
            match (suitable, devices.is_empty()) {
                (true, _) => finding,
                (false, true) => finding.lacks("no device: no driver is installed", "tools/setup run"),
                (false, false) => finding
                    .lacks("no device that can be used; lavapipe needs no graphics card", "tools/setup run"),
            }
        }
    }
}

fn validation() -> Finding {
    let finding = Finding::new("Vulkan validation");
    let desc =
        gpu::InstanceDesc { app_name: "vergence doctor", validation: true, ..gpu::InstanceDesc::default() };
    match gpu::Instance::new(&desc, None) {
        Ok(instance) if instance.validation() => finding,
        _ => finding.lacks("no validation layer: only tests need it", "tools/setup test"),
    }
}

/// Where the loader looks for the runtime that the user has chosen, in its order.
fn runtime_manifests() -> Vec<PathBuf> {
    if let Some(named) = std::env::var_os("XR_RUNTIME_JSON") {
        return vec![named.into()];
    }
    let home = std::env::var_os("HOME").map(|home| PathBuf::from(home).join(".config"));
    let user = std::env::var_os("XDG_CONFIG_HOME").map(PathBuf::from).or(home);
    let system = std::env::var("XDG_CONFIG_DIRS").unwrap_or_else(|_| "/etc/xdg".to_owned());
    let folders = user.into_iter().chain(system.split(':').map(PathBuf::from)).chain(["/etc".into()]);
    folders.map(|folder| folder.join("openxr/1/active_runtime.json")).collect()
}

fn openxr() -> Finding {
    let mut finding = Finding::new("OpenXR headset");
    let manifest = runtime_manifests().into_iter().find(|path| path.exists());
    if let Some(path) = &manifest {
        finding.found.push(format!("runtime manifest {}", path.display()));
    }
    match xr::Connection::open(xr::Way::Loader, "vergence doctor", &[]) {
        Ok(connection) => {
            let about = connection.description();
            finding.found.push(format!("{} on {}, OpenXR {}", about.headset, about.runtime, about.api));
            for (view, size) in connection.views().iter().enumerate() {
                let (width, height) = size.recommended;
                finding.found.push(format!("view {view}: {width} × {height} px recommended"));
            }
            finding
        }
        Err(error @ xr::Error::NoLoader { .. }) => finding.lacks(error.to_string(), "tools/setup run"),
        Err(error) => {
            let mend = if manifest.is_some() {
                "start the headset's software (Monado: monado-service), then vergence doctor again"
            } else {
                "install a runtime (SteamVR, WiVRn, or Debian 13: apt-get install monado-service libopenxr1-monado); \
                 a Monado without a headset, for tests: tools/monado run -- COMMAND"
            };
            finding.lacks(error.to_string(), mend)
        }
    }
}

fn simulated() -> Finding {
    let mut finding = Finding::new("simulated headset");
    finding.found.push("built in; used where no other headset is found".to_owned());
    finding
}

fn window() -> Finding {
    let finding = Finding::new("window libraries");
    // The folder of ldconfig is not on everybody's path.
    let list = ["ldconfig", "/sbin/ldconfig"]
        .into_iter()
        .find_map(|name| Command::new(name).arg("-p").output().ok().filter(|output| output.status.success()));
    let Some(list) = list else {
        return finding.lacks("the list of libraries cannot be read", "tools/setup run");
    };
    let list = String::from_utf8_lossy(&list.stdout).into_owned();
    let missing: Vec<&str> = WINDOW_LIBRARIES
        .iter()
        .filter(|(library, _)| {
            !list.lines().any(|line| line.trim_start().starts_with(&format!("{library} ")))
        })
        .map(|(_, package)| *package)
        .collect();
    if missing.is_empty() {
        return finding;
    }
    finding.lacks(format!("no window opens without {}", missing.join(", ")), "tools/setup run")
}

fn display() -> Finding {
    let mut finding = Finding::new("display");
    if let Ok(name) = std::env::var("WAYLAND_DISPLAY") {
        finding.found.push(format!("Wayland {name} (windows are opened by way of X11)"));
    }
    let mend = "run under a virtual display: xvfb-run vergence …";
    let Ok(name) = std::env::var("DISPLAY") else {
        return finding.lacks("DISPLAY is not set: --window cannot open one; everything else works", mend);
    };
    finding.found.push(format!("X11 {name}"));
    // A display of this machine has a socket; one of another machine is taken at its word.
    let number = name.strip_prefix(':').map(|rest| rest.split('.').next().unwrap_or_default());
    match number.map(|number| format!("/tmp/.X11-unix/X{number}")) {
        Some(socket) if UnixStream::connect(&socket).is_err() => {
            finding.lacks(format!("nobody answers at {socket}"), mend)
        }
        _ => finding,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_needed_decides() {
        let optional = Finding::new("optional").lacks("nothing there", "install it");
        assert!(usable(&[Finding::new("there"), optional]));
        let needed = Finding { needed: true, ..Finding::new("needed") }.lacks("nothing there", "install it");
        assert!(!usable(&[needed]));
    }
}
