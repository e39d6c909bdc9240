use vergence_report::{Axis, Cell, Column, Plot, Point, Series, Style, Table};

use crate::Trade;

/// Significant places of costs and errors in tables: more than repeated measurements agree on.
const DECIMALS: usize = 4;

/// Errors that differ by more than this factor are drawn on a logarithmic axis.
const WIDE: f64 = 10.0;

impl Trade {
    /// All measurements, the front of the scales `cost` and `error` marked, from the cheapest; what could not be
    /// measured comes last.
    ///
    /// # Panics
    /// Where an index is not below the number of scales.
    pub fn table(&self, cost: usize, error: usize) -> Table {
        let knobs = self.knobs.iter().map(|k| {
            Column::new(
                if k.unit.is_empty() { k.name.clone() } else { format!("{} ({})", k.name, k.unit) },
                2,
            )
        });
        let costs = self.costs.iter().map(|s| Column::new(s.title(), 2));
        let errors = self.errors.iter().map(|s| Column::new(s.title(), DECIMALS));
        let mut table = Table::new(knobs.chain(costs).chain(errors).collect());
        let front = self.pareto(cost, error);
        let mut order: Vec<usize> = (0..self.measurements.len()).collect();
        let key = |i: &usize| {
            Some(self.measurements[*i].costs[cost]).filter(|c| c.is_finite()).unwrap_or(f64::INFINITY)
        };
        order.sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
        for index in order {
            let measurement = &self.measurements[index];
            let knobs = measurement.setting.0.iter().map(|(_, value)| Cell::Text(value.to_string()));
            let numbers = measurement.costs.iter().chain(&measurement.errors);
            let numbers = numbers.map(|v| if v.is_nan() { Cell::Empty } else { Cell::Number(*v) });
            table.push(knobs.chain(numbers).collect(), front.contains(&index));
        }
        table
    }

    /// All measurements over cost (logarithmic) and error, with the front as steps and the `chosen` one (if any) on top.
    ///
    /// # Panics
    /// Where an index is not below the number of scales.
    pub fn plot(&self, cost: usize, error: usize, chosen: Option<usize>) -> Plot {
        self.plot_with_names(cost, error, chosen, &[])
    }

    /// The same with names at measurements that are not on the front.
    ///
    /// # Panics
    /// Where an index of a scale is not below the number of scales.
    pub fn plot_with_names(
        &self,
        cost: usize,
        error: usize,
        chosen: Option<usize>,
        names: &[(usize, String)],
    ) -> Plot {
        let point = |index: usize| {
            let m = &self.measurements[index];
            let (c, e) = (&self.costs[cost], &self.errors[error]);
            let tooltip = format!(
                "{}: {} {:.3} {}, {} {:.5} {}",
                m.setting, c.name, m.costs[cost], c.unit, e.name, m.errors[error], e.unit
            );
            Point::new(m.costs[cost], m.errors[error]).with_tooltip(tooltip.trim_end())
        };
        let front = self.pareto(cost, error);
        let labelled = |i: &usize| point(*i).labelled(self.short_label(*i));
        let named = |i: usize| match names.iter().find(|(index, _)| *index == i) {
            Some((_, name)) => point(i).labelled(name.clone()),
            None => point(i),
        };
        let others = (0..self.measurements.len()).filter(|i| !front.contains(i)).map(named).collect();
        let mut plot =
            Plot::new(self.title.clone(), Axis::log(self.costs[cost].title()), self.error_axis(error))
                .with(Series::new("beaten by another", Style::FaintPoints, others))
                .with(Series::new(self.front_name(), Style::Steps, front.iter().map(labelled).collect()));
        if let Some(chosen) = chosen.filter(|i| *i < self.measurements.len()) {
            plot = plot.with(Series::new("chosen", Style::Rings, vec![point(chosen)]));
        }
        plot
    }

    /// Logarithmic where the errors differ by more than [`WIDE`] and none is zero: on a linear axis the worst would press the rest
    /// into one line.
    fn error_axis(&self, error: usize) -> Axis {
        let finite = self.measurements.iter().map(|m| m.errors[error]).filter(|e| e.is_finite());
        let (least, most) =
            finite.fold((f64::INFINITY, 0.0f64), |(least, most), e| (least.min(e), most.max(e)));
        let title = self.errors[error].title();
        if least > 0.0 && most > WIDE * least { Axis::log(title) } else { Axis::linear(title) }
    }

    /// Says what the labels beside the front mean.
    fn front_name(&self) -> String {
        let names: Vec<&str> =
            self.knobs.iter().filter(|knob| knob.values.len() > 1).map(|knob| knob.name.as_str()).collect();
        if names.is_empty() {
            "Pareto front".to_owned()
        } else {
            format!("Pareto front ({})", names.join(" / "))
        }
    }

    /// The values of the knobs that differ anywhere, in the trade's order: `4 / 16 / 1 / on`.
    fn short_label(&self, index: usize) -> String {
        let values = self.knobs.iter().zip(&self.measurements[index].setting.0);
        let values =
            values.filter(|(knob, _)| knob.values.len() > 1).map(|(_, (_, value))| value.to_string());
        values.collect::<Vec<_>>().join(" / ")
    }
}
