//! Rows of foreign recordings: so many values of one kind at one time.

use std::borrow::Cow;

use vergence_sense::Sample;

use super::{ARRIVED_NS, CAPTURED_NS, Gathered, put_times};
use crate::message::{Message, Times};
use crate::schema::{Field, Kind, Schema};
use crate::wire::{Decoder, Encoder, WireError};

/// A sample of a foreign stream: its numbers, whole numbers, texts, in the order of the stream's columns (its notes name them). Most
/// streams have one kind only.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row<'a> {
    /// Floating point.
    pub numbers: Cow<'a, [f64]>,
    /// Whole numbers.
    pub integers: Cow<'a, [i64]>,
    /// Texts.
    pub texts: Cow<'a, [String]>,
}

impl Message for Row<'_> {
    const NAME: &'static str = "Row";
    const UNIT: &'static str = "";
    const SCHEMA: &'static Schema = &Schema {
        name: "vergence.Row",
        about: "A sample of a foreign stream; the stream's metadata names its columns.",
        fields: &[
            CAPTURED_NS,
            ARRIVED_NS,
            Field::many("numbers", 3, Kind::Double, "floating point, column by column"),
            Field::many("integers", 4, Kind::Int64, "whole numbers, column by column"),
            Field::many("texts", 5, Kind::String, "texts, column by column"),
        ],
    };

    fn encode(&self, times: Times, _frame: &str, out: &mut Encoder<'_>) {
        put_times(times, out);
        self.numbers.iter().for_each(|number| out.double(3, *number));
        self.integers.iter().for_each(|integer| out.int(4, *integer));
        self.texts.iter().for_each(|text| out.text(5, text));
    }

    fn decode(bytes: &[u8]) -> Result<Sample<Self>, WireError> {
        let mut times = Gathered::default();
        let (mut numbers, mut integers, mut texts) = (Vec::new(), Vec::new(), Vec::new());
        Decoder::new(bytes).each(|number, value| {
            match number {
                3 => numbers.push(value.double()?),
                4 => integers.push(value.int()?),
                5 => texts.push(value.text()?.to_owned()),
                _ => drop(times.take(number, value)?),
            }
            Ok(())
        })?;
        Ok(times.sample(Self {
            numbers: Cow::Owned(numbers),
            integers: Cow::Owned(integers),
            texts: Cow::Owned(texts),
        }))
    }
}
