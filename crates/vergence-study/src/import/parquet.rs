//! Parquet (feature `parquet`): columns become the text that every table is read from, and the other way round, so that the
//! numbers are the same. Numbers are written with as many digits as give them back.

use std::io::{self, Read, Write};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{ChunkReader, FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;
use parquet::record::Field;
use parquet::record::reader::RowIter;
use parquet::schema::types::Type;

use super::columns::TEXTS;
use crate::Error;
use crate::export::factor_column;

/// Text that is made at once.
const PIECE: usize = 1 << 16;

/// A Parquet file as the text of a table with a header, comma-separated. Memory is a page of each column.
pub struct ParquetText {
    rows: RowIter<'static>,
    text: Vec<u8>,
    at: usize,
}

/// Opens a Parquet file, say a [`std::fs::File`], whose columns are numbers, flags or texts.
///
/// # Errors
/// Where it is no Parquet file, or its columns have parts.
pub fn parquet_text<R: ChunkReader + 'static>(input: R) -> Result<ParquetText, Error> {
    let reader = SerializedFileReader::new(input).map_err(|error| read_error(&error))?;
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let mut text = Vec::new();
    for (i, column) in schema.columns().iter().enumerate() {
        if column.path().parts().len() != 1 || column.max_rep_level() > 0 {
            return Err(Error::Read(format!(
                "expected columns of numbers and texts, found {}",
                column.path()
            )));
        }
        if i > 0 {
            text.push(b',');
        }
        push_quoted(&mut text, column.name());
    }
    text.push(b'\n');
    Ok(ParquetText { rows: RowIter::from_file_into(Box::new(reader)), text, at: 0 })
}

fn read_error(error: &ParquetError) -> Error {
    Error::Read(format!("expected a Parquet file, found damage: {error}"))
}

fn push_quoted(text: &mut Vec<u8>, cell: &str) {
    if cell.contains([',', '"', '\n', '\r']) {
        text.push(b'"');
        text.extend_from_slice(cell.replace('"', "\"\"").as_bytes());
        text.push(b'"');
    } else {
        text.extend_from_slice(cell.as_bytes());
    }
}

impl Read for ParquetText {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.at == self.text.len() {
            self.text.clear();
            self.at = 0;
            while self.text.len() < PIECE {
                let Some(row) = self.rows.next() else { break };
                let row = row.map_err(|error| io::Error::other(read_error(&error)))?;
                for (i, (_, field)) in row.get_column_iter().enumerate() {
                    if i > 0 {
                        self.text.push(b',');
                    }
                    push_field(&mut self.text, field);
                }
                self.text.push(b'\n');
            }
        }
        let n = into.len().min(self.text.len() - self.at);
        into[..n].copy_from_slice(&self.text[self.at..self.at + n]);
        self.at += n;
        Ok(n)
    }
}

fn push_field(text: &mut Vec<u8>, field: &Field) {
    // Writing to memory does not fail.
    let done = match field {
        Field::Null => Ok(()),
        Field::Bool(flag) => write!(text, "{}", u8::from(*flag)),
        Field::Float(value) => write!(text, "{value}"),
        Field::Double(value) => write!(text, "{value}"),
        Field::Str(cell) => {
            push_quoted(text, cell);
            Ok(())
        }
        Field::Bytes(bytes) => {
            push_quoted(text, &String::from_utf8_lossy(bytes.data()));
            Ok(())
        }
        other => write!(text, "{other}"),
    };
    debug_assert!(done.is_ok(), "{done:?}");
}

/// Names and levels of factors are texts.
fn is_text(column: &str) -> bool {
    TEXTS.contains(&column) || column.starts_with(&factor_column(""))
}

/// Writes a table with a header, as [`crate::trials_csv`] makes it, as Parquet: names as texts, everything else as numbers;
/// an empty cell has no value.
///
/// # Errors
/// Where a cell is no number, or `output` takes no more.
pub fn write_parquet(table: &str, output: impl Write + Send) -> Result<(), Error> {
    let mut reader = csv::Reader::from_reader(table.as_bytes());
    let damaged = |error: csv::Error| Error::Xml {
        line: error.position().map_or(0, csv::Position::line),
        expected: "a row",
    };
    let names: Vec<String> = reader.headers().map_err(damaged)?.iter().map(str::to_owned).collect();
    let mut texts: Vec<Vec<ByteArray>> = vec![Vec::new(); names.len()];
    let mut numbers: Vec<Vec<f64>> = vec![Vec::new(); names.len()];
    let mut present: Vec<Vec<i16>> = vec![Vec::new(); names.len()];
    for row in reader.records() {
        let row = row.map_err(damaged)?;
        let line = row.position().map_or(0, csv::Position::line);
        for (i, cell) in row.iter().enumerate() {
            present[i].push(i16::from(!cell.is_empty()));
            if cell.is_empty() {
                continue;
            }
            if is_text(&names[i]) {
                texts[i].push(cell.into());
            } else {
                let number = cell.parse().map_err(|_| Error::Cell {
                    line,
                    column: names[i].clone(),
                    expected: "a number",
                    found: cell.chars().take(40).collect(),
                })?;
                numbers[i].push(number);
            }
        }
    }
    let wrong = |error: ParquetError| Error::Read(error.to_string());
    let column = |name: &String| {
        let is_text = is_text(name);
        let physical = if is_text { Physical::BYTE_ARRAY } else { Physical::DOUBLE };
        Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(is_text.then_some(LogicalType::String))
            .build()
            .map(Arc::new)
    };
    let columns = names.iter().map(column).collect::<Result<Vec<_>, _>>().map_err(wrong)?;
    let schema = Type::group_type_builder("trials").with_fields(columns).build().map_err(wrong)?;
    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY).build();
    let write = || -> Result<(), ParquetError> {
        let mut writer = SerializedFileWriter::new(output, Arc::new(schema), Arc::new(properties))?;
        let mut group = writer.next_row_group()?;
        for i in 0..names.len() {
            let Some(mut column) = group.next_column()? else { break };
            if is_text(&names[i]) {
                column.typed::<ByteArrayType>().write_batch(&texts[i], Some(&present[i]), None)?;
            } else {
                column.typed::<DoubleType>().write_batch(&numbers[i], Some(&present[i]), None)?;
            }
            column.close()?;
        }
        group.close()?;
        writer.close().map(drop)
    };
    write().map_err(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::{analyse, analyse_trials};
    use crate::export::trials_csv;
    use crate::import::{ColumnMap, Tool, import, stream};

    fn table() -> String {
        let mut text = String::from("participant,condition,mt_s,dx,dy,amplitude,width\n");
        for i in 0..3000u32 {
            let noise = f64::from(i.wrapping_mul(2_654_435_761) >> 8) / 1e6;
            text += &format!(
                "\"P,{}\",c{},{},{},{},10,2\n",
                i % 7,
                i % 3,
                0.5 + noise / 40.0,
                noise / 10.0,
                noise / 20.0
            );
        }
        text
    }

    #[test]
    fn the_same_trials_give_the_same_numbers() {
        let map = ColumnMap::default();
        let found = import(Tool::Csv, "t", &table(), &map).unwrap();
        let trials = trials_csv(&analyse_trials(&found.data, &found.conventions));
        let mut bytes = Vec::new();
        write_parquet(&trials, &mut bytes).unwrap();
        let mut back = String::new();
        parquet_text(bytes::Bytes::from(bytes.clone())).unwrap().read_to_string(&mut back).unwrap();
        assert_eq!(back, trials);
        let again = import(Tool::Csv, "t", &back, &map).unwrap();
        let own = import(Tool::Csv, "t", &trials, &map).unwrap();
        assert_eq!(analyse(&again.data, &own.conventions).rows, analyse(&own.data, &own.conventions).rows);
        let streamed =
            stream(parquet_text(bytes::Bytes::from(bytes)).unwrap(), &map, None, 2, |_| {}).unwrap();
        assert_eq!(streamed.analysis, stream(trials.as_bytes(), &map, None, 2, |_| {}).unwrap().analysis);
    }

    #[test]
    fn damage_is_an_error_and_no_panic() {
        let mut bytes = Vec::new();
        let small: String = table().lines().take(20).flat_map(|line| [line, "\n"]).collect();
        let found = import(Tool::Csv, "t", &small, &ColumnMap::default()).unwrap();
        write_parquet(&trials_csv(&analyse_trials(&found.data, &found.conventions)), &mut bytes).unwrap();
        let all = |bytes: Vec<u8>| {
            let mut text = String::new();
            parquet_text(bytes::Bytes::from(bytes))
                .map_err(|error| error.to_string())?
                .read_to_string(&mut text)
                .map_err(|error| error.to_string())
        };
        assert!(all(Vec::new()).unwrap_err().contains("expected a Parquet file"));
        for length in (0..bytes.len()).step_by(37) {
            assert!(all(bytes[..length].to_vec()).is_err());
        }
        assert!(
            write_parquet("participant,mt_s\nP1,slow\n", Vec::new())
                .unwrap_err()
                .to_string()
                .contains("\"slow\"")
        );
    }
}
