//! Log lines on stderr, and nothing but them: stdout belongs to results.

use std::io::Write;

struct Stderr;

impl log::Log for Stderr {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() <= log::max_level()
    }

    fn log(&self, record: &log::Record<'_>) {
        if self.enabled(record.metadata()) {
            let level = record.level().as_str().to_ascii_lowercase();
            // A closed stderr is no reason to fail.
            let _ = writeln!(std::io::stderr().lock(), "{level}: {}", record.args());
        }
    }

    fn flush(&self) {}
}

/// Starts logging: warnings and errors always, with `verbose` 1 what is done, with 2 and more the details.
pub fn start(verbose: u8) {
    let level = match verbose {
        0 => log::LevelFilter::Warn,
        1 => log::LevelFilter::Info,
        _ => log::LevelFilter::Debug,
    };
    // Fails only where a logger is set already, which then stays.
    if log::set_logger(&Stderr).is_ok() {
        log::set_max_level(level);
    }
}
