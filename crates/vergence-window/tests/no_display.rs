//! Without a display, a window is an error with a sentence for the user. Environment variables belong to a process, so the window is
//! opened in a process of its own.

use std::process::Command;

use vergence_window::{Error, Window};

#[test]
#[ignore = "run by the other test"]
fn inner() {
    for _ in 0..2 {
        match Window::open("no display", (100, 100)) {
            Err(error @ (Error::NoDisplay { .. } | Error::MissingLibrary { .. })) => {
                println!("told: {error}")
            }
            Err(error) => panic!("expected no display, found {error}"),
            Ok(_) => panic!("expected no display, found a window"),
        }
    }
}

#[test]
fn no_display_is_an_error() {
    for display in [None, Some(":987")] {
        let mut command = Command::new(std::env::current_exe().expect("the test is a file"));
        command.args(["--exact", "inner", "--ignored", "--nocapture"]);
        command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
        command.envs(display.map(|d| ("DISPLAY", d)));
        let output = command.output().expect("the test runs itself");
        let told = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{told}\n{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(told.matches("told: ").count(), 2, "{told}");
        // What is said is for the user: what is missing, not which line of a library missed it.
        assert!(!told.contains(".rs:") && !told.contains("cargo"), "{told}");
        let missing = display
            .map_or("DISPLAY is not set".to_owned(), |name| format!("nobody answers at DISPLAY={name}"));
        assert!(told.contains(&missing) || told.contains("is missing; install"), "{told}");
    }
}
