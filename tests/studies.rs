//! Recordings of other tools, analysed by their conventions: our numbers beside theirs.

use std::path::{Path, PathBuf};

use vergence_study::{
    ColumnMap, Conventions, Imported, Maps, Tool, analyse, analyse_trials, import, together,
};
use vergence_tests::data;

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| path.extension().is_some_and(|own| own == extension))
        .collect();
    files.sort();
    files
}

fn read(tool: Tool, path: &Path, map: &ColumnMap) -> Imported {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let name = path.file_name().expect("a file has a name").to_string_lossy();
    import(tool, &name, &text, map).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn near(what: &str, found: Option<f64>, expected: f64, tolerance: f64) {
    let found = found.unwrap_or_else(|| panic!("{what} has no value"));
    assert!((found - expected).abs() <= tolerance, "{what}: {found} instead of {expected} ± {tolerance}");
}

/// FittsStudy prints four decimals of coordinates and results: what is computed from them may be off by this.
const PRINTED: f64 = 2.5e-4;

#[test]
fn fittsstudy_logs_give_fittsstudys_own_columns() {
    let Some(folder) = data().map(|data| data.join("hci/jgp2016-fittsstudy")) else { return };
    let files = files(&folder, "csv");
    assert_eq!(files.len(), 30);
    let (mut worst, mut fit_worst, mut trials) = (0f64, [0f64; 2], 0);
    for path in files {
        let imported = read(Tool::FittsStudy, &path, &ColumnMap::default());
        let analysis = analyse(&imported.data, &imported.conventions);
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines = text.lines().skip_while(|line| !line.starts_with("Subject,"));
        let header: Vec<&str> = lines.next().unwrap().split(',').collect();
        let analysed = analyse_trials(&imported.data, &imported.conventions);
        assert_eq!(analysis.rows.len(), 12);
        for (line, one) in lines.filter(|line| !line.trim().is_empty()).zip(&analysed) {
            let cells: Vec<&str> = line.trim().split(',').collect();
            let column = |name: &str| -> f64 {
                cells[header.iter().position(|own| *own == name).unwrap()].parse().unwrap()
            };
            let row = analysis.rows.iter().find(|row| row.key.condition == one.trial.condition).unwrap();
            let (x, xy) = (row.ends.x, row.ends.xy);
            let pairs = [
                ("Ae(1d)", x.amplitude),
                ("SD(1d)", x.sd),
                ("We(1d)", x.we),
                ("IDe(1d)", x.ide),
                ("TP(1d)", x.tp),
                ("Ae(2d)", xy.amplitude),
                ("SD(2d)", xy.sd),
                ("We(2d)", xy.we),
                ("IDe(2d)", xy.ide),
                ("TP(2d)", xy.tp),
                ("Error%", row.ends.error_rate),
                ("dx(1d)", one.end.map(|end| end.dx)),
                ("ae(1d)", one.end.and_then(|end| end.ae)),
                ("ae(2d)", one.end.and_then(|end| end.ae_xy)),
            ];
            for (name, found) in pairs {
                near(&format!("{} {name}", path.display()), found, column(name), PRINTED);
                worst = worst.max((found.unwrap() - column(name)).abs());
            }
            let path_measures = one.path.unwrap();
            for (name, found) in [
                ("TAC", path_measures.tac),
                ("MDC", path_measures.mdc),
                ("ODC", path_measures.odc),
                ("MV", path_measures.mv),
                ("ME", path_measures.me),
                ("MO", path_measures.mo),
                ("Entries", path_measures.tre.map(|tre| tre + 1.0)),
            ] {
                let expected = if name == "Entries" { column(name).max(1.0) } else { column(name) };
                near(name, found, expected, 1e-9);
            }
            let fit = analysis.fit.unwrap();
            fit_worst[0] = fit_worst[0].max((fit.a * 1e3 - column("Fitts_a(1d)")).abs());
            fit_worst[1] = fit_worst[1].max((fit.b * 1e3 - column("Fitts_b(1d)")).abs());
            near("TP avg", analysis.tp_mean_of_means(), column("Fitts_TP_avg(1d)"), PRINTED);
            trials += 1;
        }
    }
    println!(
        "{trials} trials: largest difference {worst:.1e}; a {:.4} ms, b {:.4} ms/bit",
        fit_worst[0], fit_worst[1]
    );
    // With FittsStudy's cut to whole milliseconds only the print of the coordinates is left; without it a is off by 1 ms.
    assert!(fit_worst[0] < 0.03 && fit_worst[1] < 0.01, "{fit_worst:?}");
    assert_eq!(trials, 30 * 12 * 23);
}

#[test]
fn guiard_2011_has_its_table() {
    let Some(data) = data() else { return };
    let path = data.join("hci/guiard2011-strategies/final_fitts_JG_060323.csv");
    let imported = read(Tool::Csv, &path, &Maps::named("guiard2011").unwrap().unwrap());
    let analysis = analyse(&imported.data, &imported.conventions);
    assert_eq!((analysis.rows.len(), analysis.counts.trials, analysis.counts.participants), (322, 5298, 13));
    let stability = analysis.stability.as_ref().unwrap();
    let expected = [
        (0.694, 9.417, 3.863),
        (0.959, 3.883, 4.079),
        (1.191, 2.199, 3.991),
        (1.449, 1.233, 3.974),
        (2.058, 0.442, 3.538),
    ];
    for (level, (mt, sd, tp)) in stability.levels.iter().zip(expected) {
        near("MT", level.mt_s, mt, 6e-4);
        near("SD", level.sd, sd, 6e-4);
        near("TP", level.tp, tp, 6e-4);
    }
    near("CV", stability.cv, 0.054, 6e-4);
    // The map says why its asymptote of time is later than the published one. Eleven points on the front, as published.
    let who = analysis.who.unwrap();
    assert_eq!((who.y0, who.points[1]), (0.0018, 11));
    near("alpha", Some(who.alpha), 0.60, 0.02);
    near("k", Some(who.k), 0.070, 0.02);
}

#[test]
fn vive_and_mouse_in_three_planes() {
    let Some(folder) = data().map(|data| data.join("hci/3dfitts-vive")) else { return };
    let analysis = |kind: &str| {
        let parts = files(&folder.join(kind), "json")
            .iter()
            .map(|path| read(Tool::ThreeDFitts, path, &ColumnMap::default()))
            .collect();
        let all = together(parts).unwrap();
        assert!(all.warnings.is_empty(), "{:?}", all.warnings);
        analyse(&all.data, &all.conventions)
    };
    let vive = analysis("vive");
    assert_eq!((vive.rows.len(), vive.counts.trials), (54, 594));
    near("MT", vive.mean(|row| row.ends.mt_s), 1.550, 6e-4);
    near("errors", vive.error_rate(), 0.069, 6e-4);
    near("IDe", vive.mean(|row| row.ends.x.ide), 3.77, 6e-3);
    near("TP", vive.tp_mean_of_means(), 2.502, 6e-4);
    near("TP 3D", vive.tp_xy_mean_of_means(), 2.026, 6e-4);
    for (plane, tp) in [("XY", 2.600), ("YZ", 2.429), ("ZX", 2.479)] {
        let own = vive.mean(|row| row.ends.x.tp.filter(|_| row.key.factors["plane"] == plane));
        near(plane, own, tp, 6e-4);
    }
    let mouse = analysis("mouse");
    assert_eq!(mouse.rows.len(), 18);
    near("mouse TP", mouse.tp_mean_of_means(), 3.554, 6e-4);
    near("mouse TP 3D", mouse.tp_xy_mean_of_means(), 3.143, 6e-4);
    assert_eq!(Conventions::threedfitts().listed().len(), Conventions::default().listed().len());
}
