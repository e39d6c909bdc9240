//! What the columns of lines are, as lines say it, and what to say of lines that mean nothing.
//!
//! A stray word, as firmware prints them, is a line of names too. So names count from the line of numbers on that reads by them: by
//! those that came last before it, where it does not read by the ones that stand. Other names for the same number of columns count
//! where there are at least two, right in front of such a line. What once stood is gone back to where lines read by it again.

use super::lines::{Columns, Line, MOST_COLUMNS, NamesError, is_name, shown};

/// Lines of names that wait for numbers; columns that stood before.
const MOST_WAITING: usize = 4;
const MOST_BEFORE: usize = 8;

/// What a line is.
#[derive(Debug)]
pub(super) enum Heard {
    /// Numbers, by [`Table::columns`].
    Numbers(Line),
    /// The same, by columns that did not stand before.
    Anew(Line),
    /// Names, or what may have lost its beginning.
    Passed,
    /// Nothing that is understood.
    Refused,
}

/// Why a line is refused: one of a few kinds, and the sentence.
#[derive(Debug)]
pub(super) struct Refusal {
    pub(super) kind: u8,
    /// No noise looks like it.
    pub(super) is_sure: bool,
    pub(super) text: String,
}

#[derive(Clone, Debug)]
struct Names {
    columns: Columns,
    text: String,
    /// It was the first line: its beginning may be missing.
    may_be_cut: bool,
}

#[derive(Debug)]
pub(super) struct Table {
    stands: Option<Names>,
    /// The columns are the configuration's.
    is_fixed: bool,
    before: Vec<Names>,
    waiting: Vec<Names>,
    /// The next line is the first of a connection.
    is_first: bool,
}

impl Table {
    /// With the columns of the configuration, which stand for ever.
    pub(super) fn new(fixed: Option<Columns>) -> Self {
        let is_fixed = fixed.is_some();
        let stands = fixed.map(|columns| Names { columns, text: String::new(), may_be_cut: false });
        Self { stands, is_fixed, before: Vec::new(), waiting: Vec::new(), is_first: true }
    }

    pub(super) fn columns(&self) -> Option<&Columns> {
        self.stands.as_ref().map(|names| &names.columns)
    }

    /// What comes now is of another connection: its first line may have lost its beginning.
    pub(super) fn begin(&mut self) {
        self.is_first = true;
        self.waiting.clear();
    }

    /// The columns that were taken last cannot be had.
    pub(super) fn give_up(&mut self) {
        self.stands = None;
    }

    /// Takes a line.
    pub(super) fn hear(&mut self, text: &str) -> Heard {
        let is_first = std::mem::replace(&mut self.is_first, false);
        let line = self.columns().and_then(|columns| columns.read(text));
        if let Some(line) = line.filter(|_| self.waiting.is_empty() && !is_first) {
            return Heard::Numbers(line);
        }
        if self.stands.as_ref().is_some_and(|names| names.text == text) {
            self.waiting.clear();
            return Heard::Passed;
        }
        if let Ok(columns) = Columns::parse(text) {
            if !self.is_fixed {
                if self.waiting.len() == MOST_WAITING {
                    self.waiting.remove(0);
                }
                self.waiting.push(Names { columns, text: text.to_owned(), may_be_cut: is_first });
                return Heard::Passed;
            }
            let is_same = self.columns() == Some(&columns);
            return if is_same || is_first { Heard::Passed } else { Heard::Refused };
        }
        if is_first {
            return Heard::Passed;
        }
        // By names right in front of it, where they are no stray word.
        let anew = self.waiting.last().filter(|names| match &self.stands {
            Some(stands) if line.is_some() => {
                names.columns.count() > 1 || stands.may_be_cut && names.text.ends_with(&stands.text)
            }
            _ => true,
        });
        let by_last = anew.and_then(|names| names.columns.read(text));
        let read = |list: &[Names]| {
            list.iter()
                .enumerate()
                .rev()
                .find_map(|(place, names)| names.columns.read(text).map(|line| (place, line)))
        };
        let (names, read) = match (by_last, line) {
            (Some(by_last), _) => (self.waiting.pop(), by_last),
            (None, Some(line)) => {
                self.waiting.clear();
                return Heard::Numbers(line);
            }
            (None, None) => {
                if let Some((place, line)) = read(&self.waiting) {
                    (Some(self.waiting.swap_remove(place)), line)
                } else if let Some((place, line)) = read(&self.before) {
                    (Some(self.before.remove(place)), line)
                } else {
                    return Heard::Refused;
                }
            }
        };
        self.waiting.clear();
        if let Some(stood) = std::mem::replace(&mut self.stands, names) {
            if self.before.len() == MOST_BEFORE {
                self.before.remove(0);
            }
            self.before.push(stood);
        }
        Heard::Anew(read)
    }

    /// Why a line is not understood.
    pub(super) fn refuse(&self, text: &str) -> Refusal {
        let is_number = |field: &str| field.trim().parse::<f64>().is_ok();
        let numbers = text.split(',').filter(|field| is_number(field)).count();
        let all = text.split(',').count();
        let line = shown(text);
        let refusal = |kind, is_sure, why: String| Refusal {
            kind,
            is_sure,
            text: format!("the line `{line}` is not understood: {why}"),
        };
        for (kind, separator, name) in [(0, ';', "semicolons"), (1, '\t', "tabs")] {
            let fields = text.split(separator).count();
            let numbers = text.split(separator).filter(|field| is_number(&field.replace(',', "."))).count();
            if fields > 1 && (numbers == fields || text.split(separator).all(|field| is_name(field.trim()))) {
                let why = format!("expected commas between columns, and points in numbers, found {name}");
                return refusal(kind, true, why);
            }
        }
        match (self.columns(), Columns::parse(text)) {
            (Some(_), Ok(_)) => refusal(
                2,
                true,
                "it names other columns than the configuration, whose names count".to_owned(),
            ),
            (_, Err(error @ (NamesError::Twice { .. } | NamesError::TooMany { .. }))) => {
                refusal(3, true, error.to_string())
            }
            (None, _) if numbers == all && all <= MOST_COLUMNS => {
                let example: Vec<String> = (1..=all).map(|column| format!("name{column}")).collect();
                let why = format!(
                    "numbers come, and no line of names before them; the configuration can give it: [serial] columns = \"{}\"",
                    example.join(",")
                );
                refusal(4, true, why)
            }
            (Some(columns), _) if all != columns.count() && numbers > 0 => {
                refusal(5, true, format!("expected {} columns, found {all}", columns.count()))
            }
            (Some(_), _) => refusal(6, true, "expected a number in each column".to_owned()),
            (None, Ok(_)) => refusal(7, false, "expected numbers by these names".to_owned()),
            (None, Err(error)) => refusal(8, false, error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// For each line: of which columns its numbers are, if it has any.
    fn heard(table: &mut Table, text: &str) -> Vec<String> {
        let one = |line: &str| match table.hear(line) {
            Heard::Numbers(_) | Heard::Anew(_) => {
                let names: Vec<_> = table.columns().unwrap().streams().map(|stream| stream.0).collect();
                names.join("+")
            }
            Heard::Passed => "-".to_owned(),
            Heard::Refused => "?".to_owned(),
        };
        text.split_whitespace().map(one).collect()
    }

    #[test]
    fn stray_words_change_no_columns() {
        for (lines, wanted) in [
            ("x time_us,bpm 1,2 OK 3,4 ready rst 5,6", "- - bpm - bpm - - bpm"),
            // A newline lost, a line cut.
            ("x bpm 72 72.571.5 71 OK 70", "- - bpm ? bpm - bpm"),
            // A stray word in front of the piece of a line: its stream is there, and left again.
            ("x a,b 1,2 OK 3 4,5 6,7", "- - a+b - OK a+b a+b"),
            // Others are named, as many or not.
            ("x a,b 1,2 c,d 3,4 e,f,g 5,6,7 c,d 8,9", "- - a+b - c+d - e+f+g - c+d"),
            // The line of names comes before a greeting.
            ("x a,b hello 1,2", "- - - a+b"),
            // The first line of all is none of numbers, but may be one of names.
            ("2.5 1,2 a 3", "- ? - a"),
            ("pm 70 bpm 71 72", "- pm - bpm bpm"),
            ("a,b 1,2 a,b 3,4", "- a+b - a+b"),
        ] {
            let found = heard(&mut Table::new(None), lines);
            assert_eq!(found.join(" "), wanted, "{lines}");
        }
    }

    #[test]
    fn columns_of_the_configuration_stand() {
        let mut table = Table::new(Columns::parse("a,b").ok());
        let found = heard(&mut table, "5 1,2 OK 3,4 a,b c,d 5,6 7");
        assert_eq!(found, ["-", "a+b", "?", "a+b", "-", "?", "a+b", "?"]);
        table.begin();
        assert_eq!(heard(&mut table, "2,1 3,4"), ["-", "a+b"]);
    }

    #[test]
    fn what_is_wrong_with_a_line_is_said() {
        let (unnamed, named) = (Table::new(None), Table::new(Columns::parse("a,b").ok()));
        for (table, line, wanted) in [
            (&unnamed, "time_ms;bpm", "found semicolons"),
            (&unnamed, "1000;72,5", "found semicolons"),
            (&unnamed, "1\t2", "found tabs"),
            (&unnamed, "1,2", "columns = \"name1,name2\""),
            (&unnamed, "time_us,time_us,a", "'time_us' twice"),
            (&unnamed, "hello world 3", "found 'hello world 3'"),
            (&named, "1,2,3", "expected 2 columns, found 3"),
            (&named, "1,x", "expected a number"),
            (&named, "c,d", "other columns"),
        ] {
            let refusal = table.refuse(line);
            assert!(refusal.text.contains(wanted) && refusal.text.contains('`'), "{line}: {}", refusal.text);
        }
    }
}
