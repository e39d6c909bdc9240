//! The printed table: case, measured error, bound.

/// One line.
struct Row {
    case: String,
    measured: f64,
    bound: Option<f64>,
    unit: &'static str,
}

/// Collects lines, prints them all, and only then says which bounds are broken.
#[derive(Default)]
pub struct Table(Vec<Row>);

impl Table {
    /// A measured error that must not exceed `bound` (NaN always does).
    pub fn check(&mut self, case: impl Into<String>, measured: f64, bound: f64, unit: &'static str) {
        self.0.push(Row { case: case.into(), measured, bound: Some(bound), unit });
    }

    /// A number without a bound.
    pub fn tell(&mut self, case: impl Into<String>, measured: f64, unit: &'static str) {
        self.0.push(Row { case: case.into(), measured, bound: None, unit });
    }

    /// Prints the table.
    ///
    /// # Panics
    /// Where it is empty or a bound is broken.
    pub fn finish(self, title: &str) {
        assert!(!self.0.is_empty(), "nothing was measured");
        let width = self.0.iter().map(|row| row.case.chars().count()).max().unwrap_or(0);
        let mut text = format!("{title}\n{:width$}  {:>10}  {:>10}\n", "case", "measured", "bound");
        let mut broken = Vec::new();
        for row in &self.0 {
            let bound = row.bound.map_or("-".to_owned(), |bound| format!("{bound:.2e}"));
            let holds = row.bound.is_none_or(|bound| row.measured <= bound);
            let (mark, measured) = (if holds { "" } else { "  BROKEN" }, format!("{:.2e}", row.measured));
            text += &format!("{:width$}  {measured:>10}  {bound:>10} {}{mark}\n", row.case, row.unit);
            if !holds {
                broken.push(row.case.as_str());
            }
        }
        println!("{text}");
        assert!(broken.is_empty(), "out of bounds: {}", broken.join("; "));
    }
}
