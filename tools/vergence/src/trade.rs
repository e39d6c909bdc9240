//! `vergence trade`: what quality costs, measured, and the setting that fits a budget.

mod filters;
mod imu;
mod measure;
mod slam;
mod studio;

use std::fmt::Write as _;
use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};
use serde::de::{Deserialize as _, IntoDeserializer as _};
use vergence_report::Page;
use vergence_trade::{Limit, Setting, Trade, Value};

use crate::failure::Failure;
use crate::framing;
use crate::quality::{Knobs, QualityFile};
use measure::{Measured, Plan};

/// Measures what quality costs, and picks the setting that fits a budget
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Multisampling, anisotropy, render scale and normal maps: time per stereo frame against error
    ///
    /// The truth is the same view with 16 shading samples per pixel (4 x 4, each with the most edge samples,
    /// anisotropy and all normal maps), averaged in linear light. A picture of another render scale is stretched
    /// bilinearly in linear light, as a headset does, and compared at the truth's size. Errors are the mean of both
    /// eyes; with several scenes, a setting costs and errs as much as in its worst scene. Written to the folder:
    /// trade.html, trade.json, a plot (.svg), truth and cheapest picture (.png) for each scene, and with --budget or
    /// --error quality.toml.
    Render(RenderTrade),
    /// Every orientation filter, each at several positions of its main knob: time per sample against degrees
    ///
    /// Means over recordings with a truth. Written to the folder: trade.html, trade.json, a plot for 9 and one for 6 axes
    /// (.svg), and with --budget or --error imu.toml, which `imu run --config` takes.
    Imu(imu::ImuTrade),
    /// Smoothing filters, each at several positions of its knobs: jitter left against error and lag
    ///
    /// On recorded motion plus noise. Jitter left: what a filter makes of the noise alone, over the noise. Lag: the delay of the
    /// truth to which the filtered motion is nearest in the mean square (0.1 ms steps). Error: distance from the truth at the same
    /// time, root of the mean square. Written to the folder: filters.html, filters.json, plots of error and lag over jitter (.svg).
    Filters(filters::FilterTrade),
    /// Odometry: points, pyramid levels, keyframes, states and steps: CPU time per frame against position error
    ///
    /// Over one recording with a truth. Each knob is turned alone, then all of them towards speed. Written to the folder: trade.html,
    /// trade.json, slam.svg, and with --budget or --error slam.toml, which `slam run --config` takes.
    Slam(slam::SlamTrade),
}

impl Args {
    /// Measures, writes and prints.
    pub fn run(self) -> Result<(), Failure> {
        match self.what {
            What::Render(trade) => trade.run(),
            What::Imu(trade) => trade.run(),
            What::Filters(trade) => trade.run(),
            What::Slam(trade) => trade.run(),
        }
    }
}

#[derive(clap::Args)]
struct RenderTrade {
    /// Scenes to measure: .glb, .gltf, .obj, .ply or scene .toml [default: the sample room of the source tree]
    #[arg(value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Folder for the results; made where it is missing
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Choose the smallest error that takes at most this time per stereo frame, such as 40ms
    #[arg(long, value_name = "TIME", value_parser = milliseconds)]
    budget: Option<f64>,
    /// Choose the least time that errs at most this much; with --budget too, only within that
    #[arg(long, value_name = "ERROR")]
    error: Option<f64>,
    /// The error that plots, front and choice are about
    #[arg(long, value_enum, default_value_t = Metric::Flip)]
    metric: Metric,
    /// The time that plots, front and choice are about; auto: gpu where the device has timestamps and is no
    /// processor, else cpu
    #[arg(long, value_enum, default_value_t = Cost::Auto)]
    cost: Cost,
    /// Pixels per eye
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = framing::size)]
    size: (u32, u32),
    /// `three`: the cameras of the peer's benchmark; default: the scene's start, its first camera, or where all of it
    /// is seen
    #[arg(long, value_enum)]
    view: Option<Preset>,
    /// Fewer settings, three frames each
    #[arg(long)]
    quick: bool,
    /// Print one JSON object at the end instead of tables
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Metric {
    /// Visible difference when flipping between the pictures (Andersson 2020), 0 to 1
    Flip,
    /// Root of the mean square difference of the encoded values, 0 to 1
    Rmse,
    /// 1 - SSIM (Wang 2004), so that smaller is better
    Ssim,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Preset {
    Three,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Cost {
    Auto,
    /// CPU time of all threads of the process
    Cpu,
    /// Time on the device, all passes
    Gpu,
    /// From the first command to the finished picture
    Wall,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    let text: serde::de::value::StrDeserializer<'_, serde::de::value::Error> = text.into_deserializer();
    let duration = vergence_config::Duration::deserialize(text).map_err(|error| error.to_string())?;
    Ok(duration.seconds() * 1e3)
}

/// The sample scene, where the tool was built from source.
const SAMPLE_ROOM: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/../../crates/vergence-scene/samples/room.toml");

impl RenderTrade {
    fn run(self) -> Result<(), Failure> {
        let error_scale = self.metric as usize;
        let limit = Limit::of(self.budget, self.error);
        let scenes = self.scenes_or_sample()?;
        Failure::unless_folder(&self.output)?;
        let plan = Plan { scenes, size: self.size, bench_view: self.view.is_some(), quick: self.quick };
        let measured = measure::measure(&plan)?;
        let cost_scale = match self.cost {
            Cost::Cpu => measure::CPU,
            Cost::Gpu => measure::GPU,
            Cost::Wall => measure::WALL,
            Cost::Auto if measured.gpu_times_mean_something => measure::GPU,
            Cost::Auto => measure::CPU,
        };
        if cost_scale == measure::GPU && !measured.gpu_times_mean_something {
            return Err(Failure::Call(format!(
                "{} has no GPU times: use --cost cpu or wall",
                measured.device
            )));
        }
        let choice = limit.map(|limit| measured.all.choose(cost_scale, error_scale, limit)).transpose();
        let chosen = choice.as_ref().ok().copied().flatten();
        self.write(&measured, cost_scale, error_scale, chosen)?;
        self.print(&measured, cost_scale, error_scale, chosen);
        choice.map(|_| ()).map_err(|error| Failure::work(&error))
    }

    /// The scenes that were named, else the sample room.
    fn scenes_or_sample(&self) -> Result<Vec<PathBuf>, Failure> {
        if !self.scenes.is_empty() {
            return Ok(self.scenes.clone());
        }
        let sample = PathBuf::from(SAMPLE_ROOM);
        if !sample.is_file() {
            return Err(Failure::Call(format!(
                "expected a scene to measure, found none (and no sample at {SAMPLE_ROOM})"
            )));
        }
        Ok(vec![sample])
    }

    fn write(
        &self,
        measured: &Measured,
        cost: usize,
        error: usize,
        chosen: Option<usize>,
    ) -> Result<(), Failure> {
        let save = |name: &str, bytes: &[u8]| {
            let path = self.output.join(name);
            std::fs::write(&path, bytes).map_err(|e| Failure::unwritable(&path, &e))
        };
        let mut page = Page::new("What quality costs").paragraph(&format!(
            "{}, {} x {} pixels per eye. {}",
            measured.device, measured.size.0, measured.size.1, measured.method
        ));
        if let Some(chosen) = chosen {
            let m = &measured.all.measurements()[chosen];
            page = page.paragraph(&format!("Chosen: {}.", m.setting));
            let text = quality_of(&m.setting).to_toml().map_err(|e| Failure::work(&e))?;
            save("quality.toml", text.as_bytes())?;
        }
        for sentence in without_effect(&measured.all) {
            page = page.paragraph(&sentence);
        }
        let several = measured.scenes.len() > 1;
        let all = several.then_some(("trade", &measured.all));
        for (name, trade) in
            all.into_iter().chain(measured.scenes.iter().map(|s| (s.name.as_str(), &s.trade)))
        {
            let plot = trade.plot(cost, error, chosen);
            let svg = plot.to_svg().map_err(|e| Failure::work(&e))?;
            save(&format!("{name}.svg"), svg.as_bytes())?;
            page = page.heading(trade.title()).plot(&plot).map_err(|e| Failure::work(&e))?;
            page = page.table(&trade.table(cost, error));
        }
        for scene in &measured.scenes {
            for (kind, picture) in [("truth", &scene.truth_png), ("cheapest", &scene.cheapest_png)] {
                save(&format!("{}-{kind}.png", scene.name), picture)?;
                page = page.heading(&format!("{}: {kind}, left eye", scene.name));
                page = page.png(picture, &format!("{} as the left eye sees it, {kind}", scene.name));
            }
        }
        save("trade.html", page.to_html().as_bytes())?;
        let json = serde_json::to_string_pretty(&self.json(measured, cost, error, chosen));
        save("trade.json", json.map_err(|e| Failure::work(&e))?.as_bytes())
    }

    fn json(
        &self,
        measured: &Measured,
        cost: usize,
        error: usize,
        chosen: Option<usize>,
    ) -> serde_json::Value {
        let one = |trade: &Trade| serde_json::json!({ "trade": trade, "front": trade.pareto(cost, error) });
        let scenes = measured.scenes.iter().map(|s| (s.name.clone(), one(&s.trade)));
        serde_json::json!({
            "device": measured.device,
            "size": [measured.size.0, measured.size.1],
            "frames": measured.frames,
            "method": measured.method,
            "cost": measured.all.costs()[cost],
            "error": measured.all.errors()[error],
            "all": one(&measured.all),
            "scenes": scenes.collect::<serde_json::Map<_, _>>(),
            "without_effect": without_effect(&measured.all),
            "chosen": chosen.map(|index| &measured.all.measurements()[index]),
        })
    }

    fn print(&self, measured: &Measured, cost: usize, error: usize, chosen: Option<usize>) {
        if self.json {
            println!("{}", self.json(measured, cost, error, chosen));
            return;
        }
        let mut text = format!("{}\n{}\n", measured.device, measured.method);
        let _ = writeln!(
            text,
            "\n{}; * is on the Pareto front of {} and {}\n{}",
            measured.all.title(),
            measured.all.costs()[cost].title(),
            measured.all.errors()[error].title(),
            measured.all.table(cost, error).to_text()
        );
        for sentence in without_effect(&measured.all) {
            let _ = writeln!(text, "{sentence}");
        }
        if let Some(index) = chosen {
            let m = &measured.all.measurements()[index];
            let (cost_name, error_name) =
                (&measured.all.costs()[cost].name, &measured.all.errors()[error].name);
            let (c, e) = (m.costs[cost], m.errors[error]);
            let _ = writeln!(text, "chosen: {} ({cost_name} {c:.2} ms, {error_name} {e:.4})", m.setting);
            let _ = writeln!(
                text,
                "use it: vergence run SCENE --quality {}",
                self.output.join("quality.toml").display()
            );
        }
        let _ = writeln!(text, "look at it: {}", self.output.join("trade.html").display());
        print!("{text}");
    }
}

/// A sentence for each pair of values of a knob that gives the same pictures.
fn without_effect(trade: &Trade) -> Vec<String> {
    let sentence = |(knob, a, b): (usize, usize, usize)| {
        let knob = &trade.knobs()[knob];
        format!("{} {} and {} give the same pictures here.", knob.name, knob.values[a], knob.values[b])
    };
    trade.indistinct().into_iter().map(sentence).collect()
}

/// The knobs of a setting, as a file.
fn quality_of(setting: &Setting) -> QualityFile {
    let number = |name| match setting.get(name) {
        Some(Value::Number(value)) => Some(*value),
        Some(Value::Count(value)) => Some(f64::from(*value)),
        _ => None,
    };
    QualityFile {
        quality: Knobs {
            msaa: number("msaa").map(|value| value as u32),
            anisotropy: number("anisotropy").map(|value| value as f32),
            render_scale: number("render_scale"),
            normal_maps: match setting.get("normal_maps") {
                Some(Value::Switch(on)) => Some(*on),
                _ => None,
            },
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_say_their_units() {
        assert_eq!(milliseconds("40ms"), Ok(40.0));
        assert_eq!(milliseconds("0.5 s"), Ok(500.0));
        assert!(milliseconds("40").unwrap_err().contains("expected a duration"));
    }

    #[test]
    fn a_setting_becomes_the_file_that_run_takes() {
        let setting = Setting(vec![
            ("msaa".into(), Value::from(4)),
            ("anisotropy".into(), Value::from(16.0)),
            ("render_scale".into(), Value::from(0.7)),
            ("normal_maps".into(), Value::from(false)),
        ]);
        let expected = "[quality]\nmsaa = 4\nanisotropy = 16.0\nrender_scale = 0.7\nnormal_maps = false\n";
        assert_eq!(quality_of(&setting).to_toml().unwrap(), expected);
    }
}
