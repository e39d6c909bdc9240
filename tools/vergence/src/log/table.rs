//! Tables that `vergence log export` writes: CSV, and Parquet for what reads columns.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::Type;
use vergence_log::foreign::Cell;

use crate::failure::Failure;

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    Number,
    Integer,
    Truth,
    Text,
}

impl Column {
    pub const fn of(cell: &Cell) -> Self {
        match cell {
            Cell::Number(_) => Self::Number,
            Cell::Integer(_) => Self::Integer,
            Cell::Truth(_) => Self::Truth,
            Cell::Text(_) => Self::Text,
        }
    }

    /// What holds both: different kinds only go together as text.
    pub fn with(self, other: Self) -> Self {
        if self == other { self } else { Self::Text }
    }
}

/// The shortest digits that read back as the same number; what is no number is empty.
fn word(cell: Cell) -> String {
    match cell {
        Cell::Number(x) if x.is_nan() => String::new(),
        Cell::Number(x) => x.to_string(),
        Cell::Integer(x) => x.to_string(),
        Cell::Truth(x) => x.to_string(),
        Cell::Text(text) => text,
    }
}

/// A file that has its name only once it is whole: until then it is called `.part`, and is gone where it does not come to its end.
pub struct Draft {
    path: PathBuf,
    part: PathBuf,
    /// `None` once it is whole.
    file: Option<BufWriter<File>>,
}

impl Draft {
    pub fn create(path: &Path) -> Result<Self, Failure> {
        let mut part = path.as_os_str().to_owned();
        part.push(".part");
        let part = PathBuf::from(part);
        let file = File::create(&part).map_err(|e| Failure::unwritable(path, &e))?;
        Ok(Self { path: path.to_owned(), part, file: Some(BufWriter::new(file)) })
    }

    /// Gives it its name.
    pub fn keep(mut self) -> Result<(), Failure> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.flush().map_err(|e| Failure::unwritable(&self.path, &e))?;
        self.file = None;
        std::fs::rename(&self.part, &self.path).map_err(|e| Failure::unwritable(&self.path, &e))
    }
}

impl Write for Draft {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.as_mut().map_or(Ok(0), |file| file.write(bytes))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.as_mut().map_or(Ok(()), Write::flush)
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        if let Some(file) = self.file.take() {
            // What waits in memory need not be written any more.
            drop(file.into_parts());
            // Whoever asked for the file hears why there is none.
            drop(std::fs::remove_file(&self.part));
        }
    }
}

/// Where rows of a table go; a cell that is missing is empty, or null.
pub trait Table {
    fn push(&mut self, row: Vec<Option<Cell>>) -> Result<(), Failure>;
    fn finish(&mut self) -> Result<(), Failure>;
}

pub struct CsvTable {
    path: PathBuf,
    /// `None` once it is finished.
    out: Option<csv::Writer<Draft>>,
}

impl CsvTable {
    pub fn new(path: &Path, columns: &[(String, Column)]) -> Result<Self, Failure> {
        let mut out = csv::Writer::from_writer(Draft::create(path)?);
        let names = columns.iter().map(|(name, _)| name);
        out.write_record(names).map_err(|e| Failure::unwritable(path, &e))?;
        Ok(Self { path: path.to_owned(), out: Some(out) })
    }
}

impl Table for CsvTable {
    fn push(&mut self, row: Vec<Option<Cell>>) -> Result<(), Failure> {
        let words = row.into_iter().map(|cell| cell.map_or_else(String::new, word));
        let Some(out) = &mut self.out else { return Ok(()) };
        out.write_record(words).map_err(|e| Failure::unwritable(&self.path, &e))
    }

    fn finish(&mut self) -> Result<(), Failure> {
        let Some(out) = self.out.take() else { return Ok(()) };
        out.into_inner().map_err(|e| Failure::unwritable(&self.path, e.error()))?.keep()
    }
}

/// Rows are gathered and written in groups of about so many cells: memory does not grow with the log.
const CELLS_PER_GROUP: usize = 1 << 20;

pub struct ParquetTable {
    path: PathBuf,
    kinds: Vec<Column>,
    rows: Vec<Vec<Option<Cell>>>,
    /// `None` once it is finished.
    out: Option<SerializedFileWriter<Draft>>,
}

impl ParquetTable {
    pub fn new(path: &Path, columns: &[(String, Column)]) -> Result<Self, Failure> {
        let file = Draft::create(path)?;
        let open = || -> Result<SerializedFileWriter<Draft>, ParquetError> {
            let fields = columns.iter().map(|(name, kind)| {
                let (physical, logical) = match kind {
                    Column::Number => (Physical::DOUBLE, None),
                    Column::Integer => (Physical::INT64, None),
                    Column::Truth => (Physical::BOOLEAN, None),
                    Column::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
                };
                let field = Type::primitive_type_builder(name, physical)
                    .with_repetition(Repetition::OPTIONAL)
                    .with_logical_type(logical);
                Ok(Arc::new(field.build()?))
            });
            let fields = fields.collect::<Result<Vec<_>, ParquetError>>()?;
            let schema = Type::group_type_builder("row").with_fields(fields).build()?;
            let properties =
                WriterProperties::builder().set_compression(Compression::ZSTD(ZstdLevel::default())).build();
            SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))
        };
        let out = open().map_err(|e| Failure::unwritable(path, &e))?;
        let kinds = columns.iter().map(|(_, kind)| *kind).collect();
        Ok(Self { path: path.to_owned(), kinds, rows: Vec::new(), out: Some(out) })
    }

    fn group(&mut self) -> Result<(), ParquetError> {
        let Some(out) = self.out.as_mut().filter(|_| !self.rows.is_empty()) else { return Ok(()) };
        let mut group = out.next_row_group()?;
        for (place, kind) in self.kinds.iter().enumerate() {
            let Some(mut column) = group.next_column()? else { break };
            let present: Vec<i16> = self.rows.iter().map(|row| i16::from(row[place].is_some())).collect();
            let cells = self.rows.iter_mut().filter_map(|row| row[place].take());
            write(&mut column, *kind, cells, &present)?;
            column.close()?;
        }
        group.close()?;
        self.rows.clear();
        Ok(())
    }
}

/// The cells of one column; `present` says of each row whether it has one.
fn write(
    column: &mut SerializedColumnWriter<'_>,
    kind: Column,
    cells: impl Iterator<Item = Cell>,
    present: &[i16],
) -> Result<(), ParquetError> {
    // A column's kind is that of all its cells, else text: what the filters drop does not occur.
    match kind {
        Column::Number => {
            let all: Vec<f64> =
                cells.filter_map(|c| if let Cell::Number(x) = c { Some(x) } else { None }).collect();
            column.typed::<DoubleType>().write_batch(&all, Some(present), None)?;
        }
        Column::Integer => {
            let all: Vec<i64> =
                cells.filter_map(|c| if let Cell::Integer(x) = c { Some(x) } else { None }).collect();
            column.typed::<Int64Type>().write_batch(&all, Some(present), None)?;
        }
        Column::Truth => {
            let all: Vec<bool> =
                cells.filter_map(|c| if let Cell::Truth(x) = c { Some(x) } else { None }).collect();
            column.typed::<BoolType>().write_batch(&all, Some(present), None)?;
        }
        Column::Text => {
            let all: Vec<ByteArray> = cells.map(|cell| ByteArray::from(word(cell).into_bytes())).collect();
            column.typed::<ByteArrayType>().write_batch(&all, Some(present), None)?;
        }
    }
    Ok(())
}

impl Table for ParquetTable {
    fn push(&mut self, row: Vec<Option<Cell>>) -> Result<(), Failure> {
        self.rows.push(row);
        if self.rows.len() * self.kinds.len() >= CELLS_PER_GROUP {
            self.group().map_err(|e| Failure::unwritable(&self.path, &e))?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), Failure> {
        let path = self.path.clone();
        let failed = |e: ParquetError| Failure::unwritable(&path, &e);
        self.group().map_err(failed)?;
        let Some(out) = self.out.take() else { return Ok(()) };
        out.into_inner().map_err(failed)?.keep()
    }
}
