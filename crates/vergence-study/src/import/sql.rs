//! Rows that a query picks out of tables of trials (feature `sql`): DataFusion reads CSV and Parquet, of one file or of many,
//! and answers as the text that every table is read from, so that what is analysed, and how, is the same.

use std::fs::File;
use std::io::{self, Read};
use std::path::PathBuf;
use std::sync::Arc;

use datafusion::arrow::csv::{Writer, WriterBuilder};
use datafusion::arrow::datatypes::{DataType, Field, Schema};
use datafusion::dataframe::DataFrame;
use datafusion::error::{DataFusionError, Result as Answer};
use datafusion::execution::SendableRecordBatchStream;
use datafusion::prelude::{CsvReadOptions, ParquetReadOptions, SessionConfig, SessionContext};
use futures::StreamExt as _;
use tokio::runtime::{Builder, Runtime};

use super::columns::ColumnMap;
use crate::Error;

/// Rows from which it is guessed which columns are numbers.
const GUESS_ROWS: usize = 10_000;
/// Of a file, to see what stands between its cells.
const HEAD_BYTES: u64 = 1 << 16;

/// What the table is called in queries.
pub const TABLE: &str = "trials";

/// The rows that a query has found, as comma-separated text with a header. Memory is a batch of rows and what the query
/// itself has to hold (a sort, a join).
pub struct SqlText {
    runtime: Runtime,
    rows: SendableRecordBatchStream,
    text: Vec<u8>,
    at: usize,
    headed: bool,
}

/// Asks `query` of `files`, which together are the table [`TABLE`]: all CSV with the same header, or all Parquet. The rows of
/// a plain selection come in the order of the files. Columns that `map` reads as names stay as they are written, also where
/// they look like numbers (`007`); all other numbers are doubles. The answer has commas between its cells, whatever the files
/// have.
///
/// # Errors
/// Where a file cannot be read, or the query is none, or asks for what is not there.
pub fn sql_text(files: &[PathBuf], map: &ColumnMap, query: &str) -> Result<SqlText, Error> {
    let runtime = Builder::new_current_thread().build().map_err(|error| Error::Read(error.to_string()))?;
    let is = |file: &PathBuf, ending: &str| file.extension().is_some_and(|own| own == ending);
    let all = |ending: &str| !files.is_empty() && files.iter().all(|file| is(file, ending));
    let (parquet, csv) = (all("parquet"), all("csv"));
    if !parquet && !csv {
        return Err(Error::Mixed {
            expected: "all .csv or all .parquet".to_owned(),
            found: "others among them, or none".to_owned(),
        });
    }
    let paths: Vec<String> = files.iter().map(|file| file.to_string_lossy().into_owned()).collect();
    let of_files = |error: DataFusionError| Error::Read(format!("{}: {error}", paths.join(", ")));
    let mut head = Vec::new();
    let first = File::open(&files[0]).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    first.map_err(|error| Error::Read(format!("{}: {error}", paths[0])))?;
    let mark = map.with_delimiter_of(&head).delimiter();
    // One partition: rows keep their order, so that what depends on it (the serial axis, the last digit of a sum) does not
    // change. The analysis behind has its own threads.
    let context = SessionContext::new_with_config(SessionConfig::new().with_target_partitions(1));
    let rows = runtime.block_on(async {
        let table = if parquet {
            context.read_parquet(paths.clone(), ParquetReadOptions::default()).await.map_err(of_files)?
        } else {
            tables(&context, &paths, &map.texts(), mark).await.map_err(of_files)?
        };
        context.register_table(TABLE, table.into_view()).map_err(of_files)?;
        let asked = |error: DataFusionError| Error::Read(format!("--sql: {error}"));
        context.sql(query).await.map_err(asked)?.execute_stream().await.map_err(asked)
    })?;
    Ok(SqlText { runtime, rows, text: Vec::new(), at: 0, headed: false })
}

async fn tables(context: &SessionContext, paths: &[String], texts: &[&str], mark: u8) -> Answer<DataFrame> {
    let options = || CsvReadOptions::new().delimiter(mark).schema_infer_max_records(GUESS_ROWS);
    let guessed = context.read_csv(paths.to_vec(), options()).await?;
    let schema = guessed.schema().as_arrow();
    let fields = schema.fields().iter().map(|field| {
        let kind = match field.data_type() {
            _ if texts.contains(&field.name().as_str()) => DataType::Utf8,
            // Whole in the rows that were looked at.
            DataType::Int64 => DataType::Float64,
            other => other.clone(),
        };
        Field::new(field.name(), kind, true)
    });
    let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
    context.read_csv(paths.to_vec(), options().schema(&schema)).await
}

impl Read for SqlText {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.at == self.text.len() {
            self.text.clear();
            self.at = 0;
            let Some(batch) = self.runtime.block_on(self.rows.next()) else { return Ok(0) };
            let batch = batch.map_err(|error| io::Error::other(format!("--sql: {error}")))?;
            let mut writer: Writer<&mut Vec<u8>> =
                WriterBuilder::new().with_header(!self.headed).build(&mut self.text);
            writer.write(&batch).map_err(|error| io::Error::other(error.to_string()))?;
            drop(writer);
            self.headed = true;
        }
        let n = into.len().min(self.text.len() - self.at);
        into[..n].copy_from_slice(&self.text[self.at..self.at + n]);
        self.at += n;
        Ok(n)
    }
}
