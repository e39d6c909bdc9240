use std::fmt::Write as _;

use crate::text::{escaped, number};

/// Rows and columns: text for a terminal, sortable in a [`crate::Page`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    columns: Vec<Column>,
    rows: Vec<Row>,
}

#[derive(Clone, Debug, PartialEq)]
struct Row {
    cells: Vec<Cell>,
    marked: bool,
    total: bool,
}

/// The head of a column.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    title: String,
    decimals: usize,
}

/// One entry.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Left-aligned, sorted as text.
    Text(String),
    /// Right-aligned, sorted by value; printed with its column's decimals.
    Number(f64),
    /// Nothing was measured.
    Empty,
}

impl Column {
    /// `title` says what and in which unit; numbers below it get `decimals` places.
    pub fn new(title: impl Into<String>, decimals: usize) -> Self {
        Self { title: title.into(), decimals }
    }
}

impl Table {
    /// Without rows.
    pub fn new(columns: Vec<Column>) -> Self {
        Self { columns, rows: Vec::new() }
    }

    /// Adds a row; missing cells are empty, surplus ones are dropped. A `marked` row stands out (`*` in text).
    pub fn push(&mut self, cells: Vec<Cell>, marked: bool) {
        self.add(cells, marked, false);
    }

    /// Adds a row that says something of all others, marked: sorting leaves it at the foot.
    pub fn push_total(&mut self, cells: Vec<Cell>) {
        self.add(cells, true, true);
    }

    fn add(&mut self, mut cells: Vec<Cell>, marked: bool, total: bool) {
        cells.resize(self.columns.len(), Cell::Empty);
        self.rows.push(Row { cells, marked, total });
    }

    /// Without the columns in which nothing was measured in any row.
    #[must_use]
    pub fn without_empty_columns(mut self) -> Self {
        let is_there = |column: usize| self.rows.iter().any(|row| row.cells[column] != Cell::Empty);
        let kept: Vec<bool> = (0..self.columns.len()).map(is_there).collect();
        let keep = |place: &mut usize| {
            *place += 1;
            kept[*place - 1]
        };
        let mut place = 0;
        self.columns.retain(|_| keep(&mut place));
        for row in &mut self.rows {
            place = 0;
            row.cells.retain(|_| keep(&mut place));
        }
        self
    }

    /// Aligned columns, two spaces apart; a line per row, the head first.
    pub fn to_text(&self) -> String {
        let body: Vec<Vec<String>> = self.rows.iter().map(|row| self.printed(&row.cells)).collect();
        let width = |column: usize| {
            let cells = body.iter().map(|row| row[column].chars().count());
            cells.chain([self.columns[column].title.chars().count()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let numeric: Vec<bool> = (0..self.columns.len()).map(|column| self.is_numeric(column)).collect();
        let line = |mark: &str, cells: &mut dyn Iterator<Item = &str>| {
            let mut line = mark.to_owned();
            for ((cell, &width), &numeric) in cells.zip(&widths).zip(&numeric) {
                let _ =
                    if numeric { write!(line, "  {cell:>width$}") } else { write!(line, "  {cell:<width$}") };
            }
            line.trim_end().to_owned() + "\n"
        };
        let mut text = line(" ", &mut self.columns.iter().map(|column| column.title.as_str()));
        for (row, cells) in self.rows.iter().zip(&body) {
            text += &line(if row.marked { "*" } else { " " }, &mut cells.iter().map(String::as_str));
        }
        text
    }

    pub(crate) fn to_html(&self) -> String {
        let mut html = String::from("<div class=\"wide\"><table><thead><tr>");
        for column in &self.columns {
            let _ = write!(
                html,
                "<th scope=\"col\"><button type=\"button\">{}</button></th>",
                escaped(&column.title)
            );
        }
        html += "</tr></thead><tbody>\n";
        self.rows_html(&mut html, false);
        html += "</tbody>";
        if self.rows.iter().any(|row| row.total) {
            html += "<tfoot>\n";
            self.rows_html(&mut html, true);
            html += "</tfoot>";
        }
        html + "</table></div>\n"
    }

    fn rows_html(&self, html: &mut String, total: bool) {
        for row in self.rows.iter().filter(|row| row.total == total) {
            *html += if row.marked { "<tr class=\"marked\">" } else { "<tr>" };
            for (cell, printed) in row.cells.iter().zip(self.printed(&row.cells)) {
                let _ = match cell {
                    Cell::Number(value) if value.is_finite() => {
                        write!(html, "<td data-value=\"{value:e}\">{}</td>", escaped(&printed))
                    }
                    Cell::Number(_) | Cell::Empty => {
                        write!(html, "<td data-value=\"\">{}</td>", escaped(&printed))
                    }
                    Cell::Text(_) => write!(html, "<td>{}</td>", escaped(&printed)),
                };
            }
            *html += "</tr>\n";
        }
    }

    fn printed(&self, cells: &[Cell]) -> Vec<String> {
        let print = |(cell, column): (&Cell, &Column)| match cell {
            Cell::Text(text) => text.replace('\n', " "),
            Cell::Number(value) => number(*value, column.decimals),
            Cell::Empty => "–".to_owned(),
        };
        cells.iter().zip(&self.columns).map(print).collect()
    }

    fn is_numeric(&self, column: usize) -> bool {
        !self.rows.iter().any(|row| matches!(row.cells[column], Cell::Text(_)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_stay_at_the_foot() {
        let mut table = Table::new(vec![Column::new("who", 0), Column::new("x", 1)]);
        table.push_total(vec![Cell::Text("all".into()), Cell::Number(2.0)]);
        table.push(vec![Cell::Text("a".into()), Cell::Number(1.0)], false);
        let html = table.to_html();
        let (body, foot) = html.split_once("</tbody><tfoot>").unwrap();
        assert!(body.contains(">a<") && !body.contains(">all<") && foot.contains(">all<"), "{html}");
        assert!(foot.ends_with("</tfoot></table></div>\n") && !html.replace(foot, "").contains("</table>"));
    }

    #[test]
    fn columns_line_up() {
        let mut table =
            Table::new(vec![Column::new("knob", 0), Column::new("cost (ms)", 1), Column::new("x", 2)]);
        table.push(vec![Cell::Text("msaa 4".into()), Cell::Number(12.34), Cell::Empty], true);
        table.push(vec![Cell::Text("<b>".into()), Cell::Number(f64::NAN)], false);
        let expected = "   knob       cost (ms)  x\n*  msaa 4          12.3  –\n   <b>     not a number  –\n";
        assert_eq!(table.to_text(), expected);
        let html = table.to_html();
        assert!(html.contains("data-value=\"1.234e1\">12.3<") && html.contains("&lt;b&gt;"));
        let narrow = table.without_empty_columns();
        assert_eq!(narrow.columns.len(), 2);
        assert_eq!(
            narrow.to_text(),
            "   knob       cost (ms)\n*  msaa 4          12.3\n   <b>     not a number\n"
        );
    }
}
