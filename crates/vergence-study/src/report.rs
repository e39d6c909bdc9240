//! The report: one page that says what was measured, how, and what was left out.

use std::collections::BTreeMap;

use vergence_report::{Axis as PlotAxis, Cell, Column, Page, Plot, Point, Series, Style, Table};

use crate::Error;
use crate::alternatives::Alternative;
use crate::analysis::{Analysis, Row};
use crate::convention::{Axis, Difficulty, Frame, MeanTime, Outliers, PathRule, Reach, SQRT_2_PI_E};
use crate::tradeoff;
use crate::trial::PathMeasures;

/// Most rows that the page's table and plots show; the tables that `analyze` writes have all.
const MOST_ROWS: usize = 2_000;

fn shown(value: Option<f64>, decimals: usize, unit: &str) -> String {
    value.map_or_else(|| "not available".to_owned(), |value| format!("{value:.decimals$}{unit}"))
}

fn number(value: Option<f64>) -> Cell {
    value.map_or(Cell::Empty, Cell::Number)
}

/// The page. `title` heads it, `alternatives` (see [`crate::alternatives`]) become a table where there are any, `notes`
/// (warnings of importers) are printed under the exclusions, `study` (see [`crate::Study::described`]) before the methods.
///
/// # Errors
/// Where a plot cannot be drawn.
pub fn page(
    title: &str,
    analysis: &Analysis,
    alternatives: &[Alternative],
    notes: &[String],
    study: &[String],
) -> Result<Page, Error> {
    let unit = analysis.length_unit.as_str();
    let is_steering = analysis.conventions.difficulty == Difficulty::Steering;
    let many = |n: u64, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let throughput_text = if is_steering {
        format!("Tunnels: {} of A/W per second", shown(analysis.steering_rate(), 3, ""))
    } else {
        format!(
            "Throughput {} along the task axis{}",
            shown(analysis.tp_mean_of_means(), 3, " bits/s"),
            analysis
                .tp_xy_mean_of_means()
                .map_or_else(String::new, |tp| format!(", {tp:.3} bits/s in all dimensions"))
        )
    };
    let of_all = match analysis.counts.sequences {
        all if all > analysis.rows.len() => format!(" of {all}"),
        _ => String::new(),
    };
    let mut page = Page::new(title).paragraph(&format!(
        "{}, {} in {}{of_all} (participant × session × block × condition). {throughput_text}; mean movement time {}; misses {}.",
        many(analysis.counts.participants as u64, "participant"),
        many(analysis.counts.trials, "trial"),
        many(analysis.rows.len() as u64, "sequence"),
        shown(analysis.mean(|row| row.ends.mt_s), 3, " s"),
        shown(analysis.error_rate().map(|rate| 100.0 * rate), 1, " %"),
    ));
    page = page.heading(if is_steering { "Times" } else { "Throughput" }).table(&throughput(analysis));
    for (name, factor) in &analysis.factors {
        page = page.heading(&format!("By {name}")).table(&by_factor(name, factor));
    }
    if is_steering {
        page = steering(page, analysis)?;
    } else {
        page = fitts(page, analysis)?;
        page = trade(page, analysis)?;
        page = errors(page, analysis)?;
    }
    page = page.heading("Sequences");
    if analysis.rows.len() > MOST_ROWS {
        page = page.paragraph(&format!("The first {MOST_ROWS} of {}.", analysis.rows.len()));
    }
    page = page
        .paragraph(&format!(
            "Press a column's head to sort by it. Lengths in {unit}, times in seconds{}.",
            if is_steering { "" } else { ", IDe in bits, TP in bits/s" }
        ))
        .table(&sequences(analysis));
    page = page.heading("What was left out");
    let mut left = Table::new(vec![Column::new("what", 0), Column::new("how many", 0)]);
    for (what, count) in &analysis.exclusions {
        left.push(vec![Cell::Text(what.clone()), Cell::Number(*count as f64)], false);
    }
    page = page.table(&left);
    for note in notes {
        page = page.paragraph(&format!("Note: {note}."));
    }
    if !study.is_empty() {
        page = page.heading("Study");
    }
    for sentence in study {
        page = page.paragraph(sentence);
    }
    page = page.heading("Methods");
    for sentence in methods(analysis) {
        page = page.paragraph(&sentence);
    }
    let mut knobs = Table::new(vec![Column::new("convention", 0), Column::new("value", 0)]);
    for (name, value) in analysis.conventions.listed() {
        knobs.push(vec![Cell::Text(name.to_owned()), Cell::Text(value)], false);
    }
    page = page.table(&knobs);
    if alternatives.is_empty() {
        return Ok(page);
    }
    page = page.heading("What each convention does").paragraph(
        "The same trials with one convention changed at a time (the line at the foot: as above). Compare throughputs between papers only \
         where their conventions are the same.",
    );
    let titles = [
        ("convention", 0),
        ("value", 0),
        ("TP (bits/s)", 3),
        ("change (%)", 3),
        ("TP all dimensions", 3),
        ("change all (%)", 3),
        ("left out", 0),
    ];
    let mut table =
        Table::new(titles.into_iter().map(|(title, decimals)| Column::new(title, decimals)).collect());
    // Its own conventions come last, at the foot.
    for one in alternatives.iter().skip(1).chain(&alternatives[..1]) {
        let change = |value: Option<f64>, own: Option<f64>| {
            number(value.zip(own).map(|(value, own)| 100.0 * (value / own - 1.0)))
        };
        let cells = vec![
            Cell::Text(if one.knob.is_empty() { "as above".to_owned() } else { one.knob.to_owned() }),
            Cell::Text(one.value.clone()),
            number(one.tp),
            change(one.tp, analysis.tp_mean_of_means()),
            number(one.tp_xy),
            change(one.tp_xy, analysis.tp_xy_mean_of_means()),
            Cell::Number(one.left_out as f64),
        ];
        if one.knob.is_empty() { table.push_total(cells) } else { table.push(cells, false) }
    }
    Ok(page.table(&table))
}

/// Means over sequences, by instruction where there are several, else by participant.
fn throughput(analysis: &Analysis) -> Table {
    let by_instruction = analysis.stability.as_ref().is_some_and(|stability| stability.levels.len() > 1);
    let mut groups: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    for row in &analysis.rows {
        let name =
            if by_instruction { row.key.instruction.as_deref().unwrap_or("") } else { &row.key.participant };
        groups.entry(name).or_default().push(row);
    }
    let head = if by_instruction { "instruction" } else { "participant" };
    let titles = [
        (head, 0),
        ("sequences", 0),
        ("TP (bits/s)", 3),
        ("TP all dimensions", 3),
        ("TP by misses", 3),
        ("MT (s)", 3),
        ("misses (%)", 1),
        ("SD along axis", length_decimals(analysis)),
    ];
    let mut table =
        Table::new(titles.into_iter().map(|(title, decimals)| Column::new(title, decimals)).collect());
    let line = |name: &str, rows: &[&Row]| {
        let mean = |of: &dyn Fn(&Row) -> Option<f64>| {
            number(rows.iter().filter_map(|row| of(row)).collect::<vergence_stats::Moments>().mean())
        };
        vec![
            Cell::Text(name.to_owned()),
            Cell::Number(rows.len() as f64),
            mean(&|row| row.ends.x.tp),
            mean(&|row| row.ends.xy.tp),
            mean(&|row| row.by_errors.tp),
            mean(&|row| row.ends.mt_s),
            mean(&|row| row.ends.error_rate.map(|rate| 100.0 * rate)),
            mean(&|row| row.ends.x.sd),
        ]
    };
    for (name, rows) in &groups {
        table.push(line(name, rows), false);
    }
    if groups.len() > 1 {
        table.push_total(line("all", &analysis.rows.iter().collect::<Vec<_>>()));
    }
    table.without_empty_columns()
}

/// Means over sequences by the levels of one factor.
fn by_factor(name: &str, factor: &tradeoff::Stability) -> Table {
    let titles = [
        (name, 0),
        ("sequences", 0),
        ("TP (bits/s)", 3),
        ("SD over people", 3),
        ("MT (s)", 3),
        ("misses (%)", 1),
    ];
    let mut table =
        Table::new(titles.into_iter().map(|(title, decimals)| Column::new(title, decimals)).collect());
    for level in &factor.levels {
        let numbers =
            [level.tp, level.tp_sd_of_people, level.mt_s, level.error_rate.map(|rate| 100.0 * rate)];
        let mut cells = vec![Cell::Text(level.name.clone()), Cell::Number(level.sequences as f64)];
        cells.extend(numbers.map(number));
        table.push(cells, false);
    }
    table.without_empty_columns()
}

/// Decimals of lengths, so that a usual spread has three digits: 1 for pixels, 5 for metres.
fn length_decimals(analysis: &Analysis) -> usize {
    let spreads: Vec<f64> = analysis.rows.iter().filter_map(|row| row.ends.x.sd.or(row.path.mv)).collect();
    let usual = vergence_stats::median(&spreads).filter(|usual| *usual > 0.0);
    usual.map_or(4, |usual| (2.0 - usual.log10().floor()).clamp(0.0, 9.0) as usize)
}

/// Movement time and the difficulty of tunnels.
fn steering(page: Page, analysis: &Analysis) -> Result<Page, Error> {
    let mut plot = Plot::new(
        "Movement time and A/W",
        PlotAxis::linear("A/W of the tunnel"),
        PlotAxis::linear("mean movement time (s)"),
    );
    for (name, rows) in grouped(analysis) {
        let points = rows
            .iter()
            .filter_map(|row| Some(Point::new(row.id?, row.ends.mt_s?).with_tooltip(tooltip(row))));
        plot = plot.with(Series::new(name, Style::FaintPoints, points.collect()));
    }
    let mut text = "Too few sequences for a line.".to_owned();
    if let Some(fit) = &analysis.fit_nominal {
        let ids = analysis.rows.iter().filter_map(|row| row.id);
        let (low, high) = ids.fold((f64::INFINITY, 0f64), |(low, high), id| (low.min(id), high.max(id)));
        let line = [low, high].map(|x| Point::new(x, fit.a + fit.b * x)).to_vec();
        plot = plot.with(Series::new("T = a + b A/W", Style::Curve, line));
        let interval = |i: usize| {
            fit.intervals[i]
                .map_or_else(String::new, |(from, to)| format!(" (95 % interval {from:.4} to {to:.4} s)"))
        };
        text = format!(
            "T = a + b A/W over {} sequences by least squares: a = {:.4} s{}, b = {:.4} s{}, r = {}; 1/b = {:.3} of A/W per \
             second.",
            fit.n,
            fit.a,
            interval(0),
            fit.b,
            interval(1),
            shown(fit.r, 4, ""),
            1.0 / fit.b
        );
    }
    Ok(page.heading("Steering law").plot(&plot)?.paragraph(&text))
}

fn tooltip(row: &Row) -> String {
    let key = &row.key;
    if row.ends.x.ide.is_none() {
        return format!(
            "{} {} {}: MT {}",
            key.participant,
            key.session,
            key.condition,
            shown(row.ends.mt_s, 3, " s")
        );
    }
    format!(
        "{} {} {}: IDe {}, MT {}, TP {}",
        key.participant,
        key.session,
        key.condition,
        shown(row.ends.x.ide, 2, " bits"),
        shown(row.ends.mt_s, 3, " s"),
        shown(row.ends.x.tp, 2, " bits/s")
    )
}

/// Groups for the plots' legends: instructions, or one group.
fn grouped(analysis: &Analysis) -> Vec<(String, Vec<&Row>)> {
    let mut groups: BTreeMap<&str, Vec<&Row>> = BTreeMap::new();
    for row in analysis.rows.iter().take(MOST_ROWS) {
        groups.entry(row.key.instruction.as_deref().unwrap_or("sequences")).or_default().push(row);
    }
    groups.into_iter().map(|(name, rows)| (name.to_owned(), rows)).collect()
}

fn fitts(page: Page, analysis: &Analysis) -> Result<Page, Error> {
    let mut plot = Plot::new(
        "Movement time and effective difficulty",
        PlotAxis::linear("IDe (bits)"),
        PlotAxis::linear("mean movement time (s)"),
    );
    for (name, rows) in grouped(analysis) {
        let points = rows
            .iter()
            .filter_map(|row| Some(Point::new(row.ends.x.ide?, row.ends.mt_s?).with_tooltip(tooltip(row))));
        plot = plot.with(Series::new(name, Style::FaintPoints, points.collect()));
    }
    let mut text = "Too few sequences for a line.".to_owned();
    if let Some(fit) = &analysis.fit {
        let ides: Vec<f64> = analysis.rows.iter().filter_map(|row| row.ends.x.ide).collect();
        let low = ides.iter().copied().fold(f64::INFINITY, f64::min);
        let high = ides.iter().copied().fold(0.0, f64::max);
        let line = [low, high].map(|x| Point::new(x, fit.a + fit.b * x)).to_vec();
        plot = plot.with(Series::new("MT = a + b IDe", Style::Curve, line));
        let interval = |i: usize, unit: &str| {
            fit.intervals[i]
                .map_or_else(String::new, |(from, to)| format!(" (95 % interval {from:.4} to {to:.4}{unit})"))
        };
        text = format!(
            "MT = a + b IDe over {} sequences by least squares: a = {:.4} s{}, b = {:.4} s/bit{}, r = {}; 1/b = {:.3} bits/s.",
            fit.n,
            fit.a,
            interval(0, " s"),
            fit.b,
            interval(1, " s/bit"),
            shown(fit.r, 4, ""),
            1.0 / fit.b
        );
        if let Some(nominal) = &analysis.fit_nominal {
            text += &format!(
                " On the nominal ID: a = {:.4} s, b = {:.4} s/bit, r = {}.",
                nominal.a,
                nominal.b,
                shown(nominal.r, 4, "")
            );
        }
    }
    Ok(page.heading("Fitts' law").plot(&plot)?.paragraph(&text))
}

fn trade(page: Page, analysis: &Analysis) -> Result<Page, Error> {
    let mut page = page.heading("Speed against accuracy");
    let mut plot = Plot::new(
        "What speed costs in accuracy",
        PlotAxis::log("mean movement time (s)"),
        PlotAxis::log("relative spread (SD / mean amplitude)"),
    );
    for (name, rows) in grouped(analysis) {
        let points = rows.iter().filter_map(|row| {
            let spread = row.ends.x.sd? / row.ends.x.amplitude.filter(|a| *a > 0.0)?;
            Some(Point::new(row.ends.mt_s?, spread).with_tooltip(tooltip(row)))
        });
        plot = plot.with(Series::new(name, Style::FaintPoints, points.collect()));
    }
    let cloud = tradeoff::speeds_and_spreads(&analysis.rows);
    let text = match analysis.who {
        Some(fit) => {
            let front: Vec<(f64, f64)> = tradeoff::front_of(&cloud, fit.front).into_iter().map(|i| cloud[i]).collect();
            let (low, high) = front.iter().fold((f64::INFINITY, 0f64), |(low, high), (x, _)| (low.min(*x), high.max(*x)));
            let curve = (0..=40).map(|i| low * (high / low).powf(f64::from(i) / 40.0)).filter(|x| *x > fit.x0_s);
            let curve = curve.map(|x| Point::new(x, fit.y0 + (fit.k / (x - fit.x0_s).powf(fit.alpha)).powf(1.0 / (1.0 - fit.alpha))));
            plot = plot
                .with(Series::new("front", Style::Rings, front.iter().map(|(x, y)| Point::new(*x, *y)).collect()))
                .with(Series::new("fitted law", Style::Curve, curve.collect()));
            format!(
                "Weighted homographic law (y − y0)^(1−α) (x − x0)^α = k (Guiard and Rioul 2015), x mean movement time, y \
                 relative spread, fitted by least squares of logarithms to the {} front ({} of {} sequences, {} beyond the \
                 asymptotes) with x0 = {} s and y0 = {}: α = {:.3}, k = {:.4}, R² = {}.",
                fit.front.name(), fit.points[1], fit.points[0], fit.points[2], fit.x0_s, fit.y0, fit.alpha, fit.k,
                shown(fit.r2, 3, "")
            )
        }
        None => "The law of speed against accuracy has no fit: accuracy does not rise with time along the front, or it has \
                 too few points."
            .to_owned(),
    };
    page = page.plot(&plot)?.paragraph(&text);
    if let Some(cv) = analysis.stability.as_ref().and_then(|stability| stability.cv) {
        page = page.paragraph(&format!(
            "Throughput varies by {:.1} % (coefficient of variation, n − 1) between instructions.",
            100.0 * cv
        ));
    }
    let missed = analysis.rows.iter().any(|row| row.errors > 0);
    if !missed {
        page = page.paragraph("No target was missed: there is no accuracy to plot against time.");
    }
    if missed && !analysis.accuracy.is_empty() {
        let axes = (PlotAxis::linear("mean movement time of the bin (s)"), PlotAxis::linear("misses (%)"));
        let mut plot = Plot::new("Conditional accuracy: misses by movement time", axes.0, axes.1);
        for (name, bins) in &analysis.accuracy {
            let name = if name.is_empty() { "all trials" } else { name };
            let points = bins.iter().map(|bin| {
                Point::new(bin.mt_s, 100.0 * bin.error_rate).with_tooltip(format!(
                    "{:.1} % of {} trials missed",
                    100.0 * bin.error_rate,
                    bin.n
                ))
            });
            plot = plot.with(Series::new(name, Style::Line, points.collect()));
        }
        page = page.plot(&plot)?.paragraph(
            "Fifths of each sequence by movement time, and the means of these over sequences: what is slow because it is hard, or \
             because somebody is slow, is not compared with what is fast.",
        );
    }
    Ok(page)
}

fn errors(page: Page, analysis: &Analysis) -> Result<Page, Error> {
    let Some(model) = analysis
        .error_model
        .as_ref()
        .filter(|model| model.points.iter().any(|(_, observed)| *observed > 0.0))
    else {
        return Ok(page);
    };
    let axes = (PlotAxis::linear("predicted misses (%)"), PlotAxis::linear("observed misses (%)"));
    let points = model.points.iter().take(MOST_ROWS).map(|(x, y)| Point::new(100.0 * x, 100.0 * y)).collect();
    let most = model.points.iter().fold(0f64, |most, (x, y)| most.max(*x).max(*y)) * 100.0;
    let plot = Plot::new("Misses: predicted and observed", axes.0, axes.1)
        .with(Series::new("sequences", Style::FaintPoints, points))
        .with(Series::new("equal", Style::Curve, vec![Point::new(0.0, 0.0), Point::new(most, most)]));
    let text = format!(
        "Error model for pointing (Wobbrock et al. 2008): 1 − erf(2.066 (W/A)(2^((MT − a)/b) − 1)/√2) with a and b as above. \
         Observed = {} · predicted + {}, r = {}.",
        shown(model.m, 3, ""),
        shown(model.b, 4, ""),
        shown(model.r, 3, "")
    );
    Ok(page.heading("Misses").plot(&plot)?.paragraph(&text))
}

/// What a column of texts takes from a row.
type Text<'a> = &'a dyn Fn(&Row) -> String;
/// What a column of numbers takes from a row.
type Value<'a> = &'a dyn Fn(&Row) -> Option<f64>;

fn sequences(analysis: &Analysis) -> Table {
    let several = |of: &dyn Fn(&Row) -> String| {
        let mut names: Vec<String> = analysis.rows.iter().map(of).collect();
        names.sort_unstable();
        names.dedup();
        names.len() > 1
    };
    let texts: [(&str, Text<'_>); 5] = [
        ("participant", &|row| row.key.participant.clone()),
        ("session", &|row| row.key.session.clone()),
        ("block", &|row| row.key.block.clone()),
        ("condition", &|row| row.key.condition.clone()),
        ("instruction", &|row| row.key.instruction.clone().unwrap_or_default()),
    ];
    let texts: Vec<_> = texts.into_iter().filter(|(name, of)| *name == "condition" || several(of)).collect();
    let is_steering = analysis.conventions.difficulty == Difficulty::Steering;
    let decimals = length_decimals(analysis);
    let numbers: [(&str, usize, Value<'_>); 13] = [
        ("n", 0, &|row| Some(row.n as f64)),
        ("MT", 3, &|row| row.ends.mt_s),
        ("misses (%)", 1, &|row| row.ends.error_rate.map(|rate| 100.0 * rate)),
        ("A/W", 2, &|row| row.id.filter(|_| is_steering)),
        ("IDe", 3, &|row| row.ends.x.ide),
        ("TP", 3, &|row| row.ends.x.tp),
        ("TP all", 3, &|row| row.ends.xy.tp),
        ("Ae", decimals, &|row| row.ends.x.amplitude.filter(|_| !is_steering)),
        ("SD", decimals, &|row| row.ends.x.sd),
        ("We", decimals, &|row| row.ends.x.we),
        ("SD all", decimals, &|row| row.ends.xy.sd),
        ("left out", 0, &|row| Some(row.outliers as f64)),
        ("bias", decimals, &|row| row.ends.bias.filter(|_| !is_steering)),
    ];
    let paths: Vec<usize> =
        (0..9).filter(|i| analysis.rows.iter().any(|row| row.path.values()[*i].is_some())).collect();
    let columns = texts.iter().map(|(name, _)| Column::new(*name, 0));
    let columns = columns.chain(numbers.iter().map(|(name, decimals, _)| Column::new(*name, *decimals)));
    let columns = columns.chain(paths.iter().map(|i| {
        let name = PathMeasures::NAMES[*i];
        Column::new(name.to_uppercase(), if ["mv", "me", "mo"].contains(&name) { decimals } else { 2 })
    }));
    let mut table = Table::new(columns.collect());
    for row in analysis.rows.iter().take(MOST_ROWS) {
        let cells = texts.iter().map(|(_, of)| Cell::Text(of(row)));
        let cells = cells.chain(numbers.iter().map(|(_, _, of)| number(of(row))));
        let cells = cells.chain(paths.iter().map(|i| number(row.path.values()[*i])));
        table.push(cells.collect(), false);
    }
    table.without_empty_columns()
}

/// What was computed and how, in sentences for a paper.
fn methods(analysis: &Analysis) -> Vec<String> {
    let c = &analysis.conventions;
    let factor =
        if c.we_factor == SQRT_2_PI_E { "√(2πe) = 4.1327".to_owned() } else { c.we_factor.to_string() };
    let axis = match c.axis {
        Axis::Nominal => {
            "The task axis runs from the centre of the last target to the centre of this one; amplitudes are measured along it from where the movement really began."
        }
        Axis::Start => {
            "The task axis runs from where the movement really began to the centre of the target (as in FittsStudy)."
        }
        Axis::Serial => {
            "The task axis runs from the centre of the last target to the centre of this one; an amplitude is their distance plus the end's deviation, plus that of the movement before (as in GoFitts)."
        }
    };
    let spread = match (c.frame, c.reach) {
        (Frame::Task, _) => {
            "In all dimensions the spread is √(Σ|p − p̄|²/(n − 1)) of the ends relative to the target, each turned into the frame of its own axis"
        }
        (Frame::World, _) => {
            "In all dimensions the spread is √(Σ|p − p̄|²/(n − 1)) of the ends relative to the target, as recorded (not turned)"
        }
    };
    let reach = match c.reach {
        Reach::Straight => "the amplitude the mean straight distance from start to end.",
        Reach::Axis => "the amplitude the same as along the axis.",
    };
    let id = match c.difficulty {
        Difficulty::Shannon => "log2(A/W + 1)",
        Difficulty::Fitts => "log2(2 A/W)",
        Difficulty::Steering => "A/W",
        Difficulty::Angular => "log2(α/ω³ + 1)² (Kopper et al. 2010, in bits²)",
        Difficulty::Meyer => "2 √(A/W) (Meyer et al. 1988, without unit)",
    };
    let time = match c.mean_time {
        MeanTime::Exact => "",
        MeanTime::WholeMs => " Mean movement times are cut to whole milliseconds.",
    };
    let outliers = match c.outliers {
        Outliers::Keep => "No trial was left out as an outlier.",
        Outliers::Spatial => {
            "Misses that ended before half the amplitude or more than 2 W from the centre were left out."
        }
        Outliers::ThreeSd => {
            "Trials whose time or end lies more than 3 SD from the mean of its sequence were left out; in a sequence of 10 trials or fewer none can."
        }
        Outliers::Mad => {
            "Trials whose time lies more than 3 scaled median absolute deviations from the median of its sequence were left out."
        }
        Outliers::Temporal => "Trials outside of 75 % to 125 % of the metronome's time were left out.",
        Outliers::Misses => "Missed targets were left out.",
    };
    let path = match c.path {
        PathRule::Thresholds => format!(
            "Paths are taken as recorded; crossings count beyond ±{} {u}, turns beyond {} {u}.",
            c.crossing_band,
            c.turn_jump,
            u = analysis.length_unit
        ),
        PathRule::GoFitts => format!(
            "Paths are counted as GoFitts does: directions without runs of one or two steps; crossings beyond ±{} {u}, turns behind \
             {} {u}.",
            c.crossing_band,
            c.turn_jump,
            u = analysis.length_unit
        ),
        PathRule::Smoothed => {
            "Paths are resampled at 100 Hz and smoothed by a Gaussian of 5 samples before counting."
                .to_owned()
        }
    };
    let path = format!(
        "{path} Paths are taken in the frame of the axis: x along it, y beside it. TRE: entries of the target after the first. TAC: \
         crossings of the axis. MDC, ODC: turns of y, of x. MV: SD of y (n − 1); ME: mean |y|; MO: mean y (MacKenzie, Kauppinen and \
         Silfverberg 2001). Submovements are peaks of the speed, smoothed (Meyer et al. 1988); overshoots, passages of the target's \
         far side."
    );
    let computed = format!("Computed by vergence-study {}.", env!("CARGO_PKG_VERSION"));
    if c.difficulty == Difficulty::Steering {
        return vec![
            format!(
                "Difficulty is ID = {id} of each tunnel, amplitude (length) over width, without unit; T = a + b ID (Accot and Zhai \
                 1997). Where a tunnel was left says nothing of accuracy: there is no effective width and no throughput. A miss is a \
                 tunnel that was left sideways.{time}"
            ),
            format!("{outliers} Misses are counted among all trials that are not practice."),
            path,
            computed,
        ];
    }
    vec![
        format!(
            "Difficulty is ID = {id} (bits); effective width We = {factor} · SD of the ends along the task axis (n − 1), IDe with the mean amplitude Ae, throughput TP = IDe / mean MT for each sequence, then the mean of these means. Points of different people are never pooled.{time}"
        ),
        axis.to_owned(),
        format!("{spread}; {reach}"),
        "Throughput by misses takes nothing from the ends but how many missed: We = W · 2.066/z(1 − misses/2), and 0.5089 W where \
         none did (MacKenzie 1992; Soukoreff and MacKenzie 2004), with the nominal amplitude."
            .to_owned(),
        format!("{outliers} Misses are counted among all trials that are not practice."),
        path,
        computed,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alternatives::alternatives;
    use crate::analysis::analyse;
    use crate::import::{ColumnMap, Tool, import};

    #[test]
    fn a_page_has_plots_tables_and_methods() {
        let mut text = String::from("participant,instruction,condition,mt_s,dx,amplitude,width\n");
        for i in 0..240u32 {
            let (p, s, c) = (i % 4, i / 4 % 3, i / 12 % 4);
            let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 16) / 65_536.0 - 0.5;
            let speed = f64::from(s + 1);
            text += &format!(
                "P{p},{},c{c},{},{},{},20\n",
                ["fast", "even", "slow"][s as usize],
                0.2 * speed + 0.1 * f64::from(c) + 0.05 * noise,
                30.0 * noise / speed,
                100 * (c + 1)
            );
        }
        let found = import(Tool::Csv, "t", &text, &ColumnMap::default()).unwrap();
        let analysis = analyse(&found.data, &found.conventions);
        let html = page(
            "Test <1>",
            &analysis,
            &alternatives(&found.data, &found.conventions),
            &["a note".into()],
            &["a ring".into()],
        )
        .unwrap()
        .to_html();
        assert_eq!(html.matches("<svg").count(), 2 * 4);
        for part in [
            "Test &lt;1&gt;",
            "√(2πe)",
            "MT = a + b IDe over",
            "Guiard and Rioul",
            "Note: a note.",
            "What was left out",
            "P3",
        ] {
            assert!(html.contains(part), "{part}");
        }
        assert!(!html.contains("NaN") && !html.contains("http-equiv=\"refresh"));
    }
}
