//! A trade with made-up numbers, to look at: `cargo run --example made_up > trade.html`.

use vergence_report::Page;
use vergence_trade::{Knob, Limit, Measurement, Scale, Trade, Value};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let knobs = vec![
        Knob::new("msaa", "samples", vec![Value::from(1), Value::from(4)]),
        Knob::new("anisotropy", "", vec![Value::from(1.0), Value::from(4.0), Value::from(16.0)]),
        Knob::new("render_scale", "", [0.5, 0.7, 1.0, 1.4].map(Value::from).into()),
        Knob::new("normal_maps", "", vec![Value::from(false), Value::from(true)]),
    ];
    let mut trade =
        Trade::new("Made up", knobs, vec![Scale::new("CPU", "ms")], vec![Scale::new("FLIP", "")])?;
    for (i, setting) in trade.grid().into_iter().enumerate() {
        let effort: f64 = setting.0.iter().map(|(_, v)| v.to_string().len() as f64).sum();
        let wobble = ((i * 7919) % 101) as f64 / 101.0;
        let (cost, error) = (
            effort * (1.0 + 0.4 * wobble) * (1.0 + i as f64 / 20.0),
            0.1 / (1.0 + i as f64 / 9.0) * (0.6 + 0.4 * wobble),
        );
        trade.push(Measurement { setting, costs: vec![cost], errors: vec![error] })?;
    }
    let chosen = trade.choose(0, 0, Limit::Cost(20.0))?;
    let page =
        Page::new("Made up").paragraph("Nothing here was measured.").plot(&trade.plot(0, 0, Some(chosen)))?;
    print!("{}", page.table(&trade.table(0, 0)).to_html());
    Ok(())
}
