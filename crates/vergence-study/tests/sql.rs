//! Tables that DataFusion reads give the same numbers as tables that we read: the same text reaches the same analysis.
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::io::Read as _;
use std::path::PathBuf;

use vergence_study::{ColumnMap, Tool, analyse, import, sql_text, stream};

/// Participants whose names look like numbers, and numbers with all their digits.
fn table(people: std::ops::Range<u32>) -> String {
    let mut text = String::from("participant,block,condition,mt_s,dx,dy,amplitude,width,error\n");
    for i in people.start * 400..people.end * 400 {
        let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 8) / 1e6;
        let absent = if i % 97 == 0 { String::new() } else { (0.5 + noise / 40.0).to_string() };
        text += &format!(
            "{:03},1,\"c,{}\",{absent},{},{},10,2,{}\n",
            i / 400,
            i % 3,
            noise / 10.0 - 0.8,
            -noise / 30.0,
            i % 11 == 0
        );
    }
    text
}

fn asked(files: &[PathBuf], query: &str) -> Result<String, String> {
    let mut text = String::new();
    let mut rows = sql_text(files, &ColumnMap::default(), query).map_err(|error| error.to_string())?;
    rows.read_to_string(&mut text).map_err(|error| error.to_string())?;
    Ok(text)
}

#[test]
fn the_same_analysis_and_the_same_numbers() {
    let dir = tempfile::tempdir().unwrap();
    let (first, second) = (dir.path().join("a.csv"), dir.path().join("b.csv"));
    std::fs::write(&first, table(0..6)).unwrap();
    std::fs::write(&second, table(6..9)).unwrap();
    let map = ColumnMap::default();
    let whole = table(0..9);
    let own = import(Tool::Csv, "t", &whole, &map).unwrap();
    let files = [first, second];
    let text = asked(&files, "SELECT * FROM trials").unwrap();
    let theirs = import(Tool::Csv, "t", &text, &map).unwrap();
    assert_eq!(theirs, own);
    assert_eq!(analyse(&theirs.data, &own.conventions), analyse(&own.data, &own.conventions));
    assert!(text.contains("\n007,"), "{}", text.lines().nth(1).unwrap());
    // As it is streamed, in one pass.
    let rows = sql_text(&files, &map, "SELECT * FROM trials").unwrap();
    let streamed = stream(rows, &map, None, 2, |_| {}).unwrap();
    assert_eq!(streamed, stream(whole.as_bytes(), &map, None, 2, |_| {}).unwrap());
    assert_eq!(streamed.analysis.counts.participants, 9);

    // As Parquet, which DataFusion writes itself.
    let parquet = dir.path().join("all.parquet");
    let copy = format!("COPY trials TO '{}' STORED AS PARQUET", parquet.display());
    asked(&files, &copy).unwrap();
    assert!(std::fs::read(&parquet).unwrap().starts_with(b"PAR1"));
    let text = asked(&[parquet], "SELECT * FROM trials").unwrap();
    assert_eq!(import(Tool::Csv, "t", &text, &map).unwrap(), own);
}

#[test]
fn a_query_picks_rows_and_makes_columns() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.csv");
    std::fs::write(&file, table(0..4)).unwrap();
    let query = "SELECT participant, condition, 1000 * mt_s AS mt, dx, amplitude, width FROM trials \
                 WHERE participant <> '002' AND mt_s < 1 ORDER BY participant, mt";
    let text = asked(&[file], query).unwrap();
    let map = ColumnMap::parse(
        "m".as_ref(),
        "time_unit = \"ms\"\n[columns]\nparticipant = \"participant\"\ncondition = [\"condition\"]\nmt = \"mt\"\ndx = \"dx\"\n\
         amplitude = \"amplitude\"\nwidth = \"width\"",
    );
    let found = import(Tool::Csv, "t", &text, &map.unwrap()).unwrap();
    let analysis = analyse(&found.data, &found.conventions);
    assert_eq!(analysis.counts.participants, 3);
    assert!(found.data.trials.iter().all(|trial| trial.participant != "002" && trial.mt_s < 1.0));
}

#[test]
fn semicolons_are_seen_and_numbers_may_cease_to_be_whole() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.csv");
    let mut text = table(0..1).replace(',', ";").replace("\"c;", "\"c,");
    // Behind the rows from which the columns are guessed.
    for i in 0..12_000 {
        text +=
            &format!("007;1;c;0.{};{};0;{};2;0\n", 5 + i % 3, i % 5, if i < 11_000 { "10" } else { "10.5" });
    }
    std::fs::write(&file, &text).unwrap();
    let own = import(Tool::Csv, "t", &text, &ColumnMap::default()).unwrap();
    let asked = asked(&[file], "SELECT * FROM trials").unwrap();
    assert_eq!(import(Tool::Csv, "t", &asked, &ColumnMap::default()).unwrap(), own);
}

#[test]
fn mistakes_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let (file, damaged) = (dir.path().join("a.csv"), dir.path().join("b.parquet"));
    std::fs::write(&file, table(0..1)).unwrap();
    std::fs::write(&damaged, "PAR1 and nothing behind").unwrap();
    let error = |files: &[PathBuf], query: &str| asked(files, query).unwrap_err();
    assert!(error(std::slice::from_ref(&file), "SELEC 1").contains("--sql"));
    assert!(error(std::slice::from_ref(&file), "SELECT nobody FROM trials").contains("nobody"));
    assert!(error(std::slice::from_ref(&file), "SELECT 1 / 0").contains("--sql"));
    assert!(error(std::slice::from_ref(&damaged), "SELECT * FROM trials").contains("b.parquet"));
    assert!(error(&[file, damaged], "SELECT 1").contains("all .csv or all .parquet"));
    assert!(error(&[], "SELECT 1").contains("all .csv"));
}
