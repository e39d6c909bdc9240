use crate::{Decimal, Error};

/// Most columns of a table.
pub const MAX_COLUMNS: usize = 1_000;

/// A file of rows and columns: CSV (comma, semicolon or tab), columns between blanks, or a file of NIST's Statistical
/// Reference Datasets.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Names of the columns; `c1`, `c2` … where the file has none.
    pub names: Vec<String>,
    /// The cells of each column, without blanks around them.
    pub columns: Vec<Vec<String>>,
    /// The line of each row, counted from 1.
    pub lines: Vec<u64>,
    /// The degree of the polynomial that a NIST file asks for.
    pub degree: Option<u32>,
    /// False where a NIST file's model has no intercept.
    pub intercept: bool,
}

impl Table {
    /// Reads a whole file.
    ///
    /// # Errors
    /// Where rows differ in length, there is none, or there are more than [`MAX_COLUMNS`] columns.
    pub fn parse(text: &str) -> Result<Self, Error> {
        if text.trim_start().starts_with("NIST/ITL StRD") { Self::nist(text) } else { Self::plain(text) }
    }

    /// The place of the column `name`.
    ///
    /// # Errors
    /// Where there is none of that name.
    pub fn column(&self, name: &str) -> Result<usize, Error> {
        let place = self.names.iter().position(|own| own == name);
        place.ok_or_else(|| Error::Column { expected: self.names.join(", "), found: name.to_owned() })
    }

    /// A column as numbers, exactly as written.
    ///
    /// # Errors
    /// Where a cell is no number: the line is named.
    pub fn decimals(&self, column: usize) -> Result<Vec<Decimal>, Error> {
        let parse = |(cell, line): (&String, &u64)| {
            cell.parse().map_err(|error: Error| Error::Table {
                line: *line,
                message: format!("column {:?}: {error}", self.names[column]),
            })
        };
        self.columns[column].iter().zip(&self.lines).map(parse).collect()
    }

    fn plain(text: &str) -> Result<Self, Error> {
        let text = text.trim_start_matches('\u{feff}');
        let first = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#')).unwrap_or("");
        let delimiter = [',', ';', '\t'].into_iter().find(|d| first.contains(*d));
        let mut rows: Vec<(u64, Vec<String>)> = Vec::new();
        match delimiter {
            Some(delimiter) => {
                let mut reader = csv::ReaderBuilder::new()
                    .delimiter(delimiter as u8)
                    .has_headers(false)
                    .flexible(true)
                    .comment(Some(b'#'))
                    .trim(csv::Trim::All)
                    .from_reader(text.as_bytes());
                for record in reader.records() {
                    let record = record.map_err(|error| Error::Table {
                        line: error.position().map_or(0, csv::Position::line),
                        message: error.to_string(),
                    })?;
                    let line = record.position().map_or(0, csv::Position::line);
                    if record.iter().any(|cell| !cell.is_empty()) {
                        rows.push((line, record.iter().map(str::to_owned).collect()));
                    }
                }
            }
            None => rows.extend(between_blanks(text.lines().enumerate())),
        }
        let head = match rows.as_slice() {
            [(_, first), (_, second), ..] => {
                let is_number = |cell: &String| cell.parse::<Decimal>().is_ok();
                first.iter().zip(second).any(|(a, b)| !is_number(a) && is_number(b))
            }
            _ => false,
        };
        let names = if head { rows.remove(0).1 } else { Vec::new() };
        Self::from_rows(names, rows)
    }

    /// The header of a NIST file says which lines hold the data; the line before them names the columns.
    fn nist(text: &str) -> Result<Self, Error> {
        let missing =
            |what: &str| Error::Table { line: 1, message: format!("expected {what} in the header") };
        let lines: Vec<&str> = text.lines().collect();
        let place = lines
            .iter()
            .take(60)
            .find(|line| line.trim_start().starts_with("Data  ") && line.contains("(lines"));
        let place = place.ok_or_else(|| missing("'Data (lines a to b)'"))?;
        let numbers: Vec<usize> =
            place.split(|c: char| !c.is_ascii_digit()).filter_map(|part| part.parse().ok()).collect();
        let [from, to] = numbers[..] else { return Err(missing("'Data (lines a to b)'")) };
        if from < 2 || to < from || to > lines.len() {
            return Err(missing("line numbers within the file"));
        }
        let names = lines[from - 2].trim().trim_start_matches("Data:");
        let names = names.split_whitespace().map(str::to_owned).collect();
        let model: String = lines[..from]
            .iter()
            .skip_while(|line| !line.starts_with("Model:"))
            .take_while(|line| !line.contains("Certified"))
            .copied()
            .collect();
        let powers = model.split("**").skip(1).filter_map(|rest| {
            rest.chars().take_while(char::is_ascii_digit).collect::<String>().parse::<u32>().ok()
        });
        let degree = powers.max();
        let rows =
            between_blanks(lines[from - 1..to].iter().enumerate().map(|(i, line)| (from - 1 + i, *line)));
        let table = Self::from_rows(names, rows)?;
        Ok(Self { degree, intercept: model.contains("B0") || !model.contains("B1"), ..table })
    }

    fn from_rows(names: Vec<String>, rows: Vec<(u64, Vec<String>)>) -> Result<Self, Error> {
        let Some((line, first)) = rows.first() else {
            return Err(Error::Table { line: 1, message: "expected rows of data, found none".to_owned() });
        };
        let width = if names.is_empty() { first.len() } else { names.len() };
        if width > MAX_COLUMNS {
            let message = format!("expected at most {MAX_COLUMNS} columns, found {width}");
            return Err(Error::Table { line: *line, message });
        }
        let names = if names.is_empty() { (1..=width).map(|i| format!("c{i}")).collect() } else { names };
        let mut columns = vec![Vec::with_capacity(rows.len()); width];
        let mut lines = Vec::with_capacity(rows.len());
        for (line, row) in rows {
            if row.len() != width {
                let message = format!("expected {width} columns, found {}", row.len());
                return Err(Error::Table { line, message });
            }
            lines.push(line);
            columns.iter_mut().zip(row).for_each(|(column, cell)| column.push(cell));
        }
        Ok(Self { names, columns, lines, degree: None, intercept: true })
    }
}

/// The words of each line that has some, with the line's number.
fn between_blanks<'a>(lines: impl Iterator<Item = (usize, &'a str)>) -> Vec<(u64, Vec<String>)> {
    lines
        .filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'))
        .map(|(i, line)| (i as u64 + 1, line.split_whitespace().map(str::to_owned).collect()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn delimiters_heads_and_blanks() {
        for text in [
            "a,b\n1,2\n3,4\n",
            "a;b\r\n1;2\r\n3;4",
            "a\tb\n1\t2\n\n3\t4\n",
            "a b\n1  2\n 3 4\n",
            "\u{feff}a,b\n# c\n1,2\n3,4",
        ] {
            let table = Table::parse(text).unwrap();
            assert_eq!(
                (table.names.join(""), table.columns[1].join("")),
                ("ab".into(), "24".into()),
                "{text:?}"
            );
        }
        assert_eq!(Table::parse("1,2\n3,4").unwrap().names, ["c1", "c2"]);
        let text = Table::parse("group,y\nred,1\nblue,2\n").unwrap();
        assert_eq!(text.columns[0], ["red", "blue"]);
    }

    #[test]
    fn damage_is_named_with_its_line() {
        let error = Table::parse("a,b\n1,2\n3\n").unwrap_err();
        assert_eq!(error.to_string(), "line 3: expected 2 columns, found 1");
        let table = Table::parse("a,b\n1,2\n3,x\n").unwrap();
        assert!(
            table
                .decimals(1)
                .unwrap_err()
                .to_string()
                .starts_with("line 3: column \"b\": expected a decimal")
        );
        assert!(table.column("c").unwrap_err().to_string().contains("a, b"));
        assert!(Table::parse("").is_err());
        assert!(Table::parse("NIST/ITL StRD\nData   (lines 9 to 99)\n").is_err());
    }

    proptest! {
        #[test]
        fn any_text_is_an_answer(text in "[0-9a,;\\t\\n\" #.(NIST/lines)]{0,80}") {
            let _ = Table::parse(&text);
            let _ = Table::parse(&format!("NIST/ITL StRD\nData   (lines 3 to 4)\n{text}"));
        }
    }
}
