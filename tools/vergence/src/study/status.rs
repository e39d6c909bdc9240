//! `vergence study status` and `delete`: the folder of a study's data.

use std::io::IsTerminal as _;
use std::path::PathBuf;

use vergence_experiment::{Folder, Status as Found};

use super::run::failed;
use crate::failure::Failure;

/// Who has finished what; what is incomplete, doubled, copied, damaged, or in other units
///
/// Reads every log. Exit status 1 where something is wrong; that somebody has not finished is not.
#[derive(clap::Args)]
pub struct Status {
    /// Folder of the study's data
    dir: PathBuf,
    /// Print one JSON object at the end instead of text
    #[arg(long)]
    json: bool,
}

impl Status {
    /// Runs it.
    pub fn run(self) -> Result<(), Failure> {
        let folder = Folder::open(&self.dir).map_err(|error| failed(&error))?;
        let found = Found::of(&folder).map_err(|error| failed(&error))?;
        if self.json {
            let json = serde_json::to_string(&found).map_err(|error| Failure::work(&error))?;
            println!("{json}");
        } else {
            let finished = found.participants.iter().filter(|one| one.finished).count();
            println!(
                "{}: {finished} of {} participants have finished{}{}",
                found.study,
                found.planned_participants,
                if found.deleted > 0 { format!(", {} deleted", found.deleted) } else { String::new() },
                if found.in_use { "; somebody takes part now" } else { "" }
            );
            for one in &found.participants {
                println!(
                    "  {:<12} {:>5} of {} trials{}, {}",
                    one.participant,
                    one.trials,
                    one.planned,
                    if one.finished { ", finished" } else { "" },
                    one.input
                );
            }
            for finding in &found.findings {
                let kind = serde_json::to_value(finding.kind).unwrap_or_default();
                println!("{}: {}: {}", finding.file, kind.as_str().unwrap_or("found"), finding.text);
            }
        }
        if found.is_sound() {
            return Ok(());
        }
        let wrong =
            found.findings.iter().filter(|one| one.kind < vergence_experiment::Kind::Incomplete).count();
        Err(Failure::Work(format!("{}: {wrong} things are wrong with the data", self.dir.display())))
    }
}

/// Deletes a participant: nothing is left but that somebody was deleted, and when
#[derive(clap::Args)]
pub struct Delete {
    /// Folder of the study's data
    dir: PathBuf,
    /// Pseudonym
    #[arg(long, value_name = "NAME")]
    participant: String,
    /// Do not ask (a terminal is asked otherwise)
    #[arg(long)]
    yes: bool,
}

impl Delete {
    /// Runs it.
    pub fn run(self) -> Result<(), Failure> {
        let mut folder = Folder::open(&self.dir).map_err(|error| failed(&error))?;
        let own = || folder.sittings().iter().filter(|sitting| sitting.participant == self.participant);
        let (logs, trials) = (own().count(), own().map(|sitting| sitting.trials).sum::<u64>());
        if logs > 0 && !self.yes && std::io::stdin().is_terminal() {
            eprint!(
                "{}: {logs} logs with {trials} trials will be gone for ever. Delete them? [y/N] ",
                self.participant
            );
            let mut answer = String::new();
            let read = std::io::stdin().read_line(&mut answer);
            if read.is_err() || !matches!(answer.trim(), "y" | "Y" | "yes") {
                return Err(Failure::Call("nothing was deleted".to_owned()));
            }
        }
        let naming = folder.delete(&self.participant).map_err(|error| failed(&error))?;
        println!("deleted: {logs} logs with {trials} trials");
        eprintln!(
            "what was made of them elsewhere (tables, reports, imports, recordings of whole sessions) still has them"
        );
        for path in naming {
            eprintln!("{} still names them: make it anew, or remove it", path.display());
        }
        Ok(())
    }
}
