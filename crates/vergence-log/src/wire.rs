//! The wire format of protocol buffers (varint, 64-bit, length-delimited, 32-bit).
//!
//! Own code, because a generated encoder leaves out a field whose value compares equal to its default, and −0 compares
//! equal to 0: the sign would be lost. This one writes every field, borrows its strings and allocates nothing once the
//! buffer has grown. Source: "Encoding", Protocol Buffers documentation.

/// Why bytes are no message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The message ends inside of a field.
    #[error("expected {expected} more bytes at byte {at} of the message, found {found}")]
    Short {
        /// Place in the message.
        at: usize,
        /// Bytes wanted.
        expected: u64,
        /// Bytes left.
        found: usize,
    },
    /// A number does not end.
    #[error("expected a number of at most 64 bits at byte {at} of the message")]
    Varint {
        /// Place in the message.
        at: usize,
    },
    /// A tag that no message has.
    #[error("expected a field at byte {at} of the message, found tag {tag}")]
    Tag {
        /// Place in the message.
        at: usize,
        /// As read.
        tag: u64,
    },
    /// A field has another shape than the schema says.
    #[error("expected {expected}, found {found}")]
    Shape {
        /// As the schema says.
        expected: &'static str,
        /// As found.
        found: &'static str,
    },
    /// A value that cannot be.
    #[error("{what}: expected {expected}, found {found}")]
    Value {
        /// Which value.
        what: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
}

/// Writes fields to the end of a buffer.
#[derive(Debug)]
pub struct Encoder<'a> {
    out: &'a mut Vec<u8>,
}

impl<'a> Encoder<'a> {
    /// Appends to `out`.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        Self { out }
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.out.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.out.push(value as u8);
    }

    fn key(&mut self, field: u32, wire: u32) {
        self.varint(u64::from(field << 3 | wire));
    }

    /// A value of fixed size behind its key, in one piece: numbers are most of what a frame says.
    fn fixed<const N: usize>(&mut self, field: u32, wire: u32, value: [u8; N]) {
        let tag = field << 3 | wire;
        if tag < 0x80 {
            let mut both = [0; 9];
            both[0] = tag as u8;
            both[1..=N].copy_from_slice(&value);
            self.out.extend_from_slice(&both[..=N]);
        } else {
            self.varint(u64::from(tag));
            self.out.extend_from_slice(&value);
        }
    }

    /// A `uint32`, `uint64` or enumeration.
    pub fn uint(&mut self, field: u32, value: u64) {
        self.key(field, 0);
        self.varint(value);
    }

    /// An `int32` or `int64`.
    pub fn int(&mut self, field: u32, value: i64) {
        self.uint(field, value as u64);
    }

    /// A `bool`.
    pub fn bool(&mut self, field: u32, value: bool) {
        self.uint(field, u64::from(value));
    }

    /// An `sfixed64`.
    pub fn sfixed64(&mut self, field: u32, value: i64) {
        self.fixed(field, 1, value.to_le_bytes());
    }

    /// A `double`.
    pub fn double(&mut self, field: u32, value: f64) {
        self.fixed(field, 1, value.to_bits().to_le_bytes());
    }

    /// A `double` that holds all bits of a single-precision number.
    pub fn double_of(&mut self, field: u32, value: f32) {
        self.double(field, widen(value));
    }

    /// A `float`.
    pub fn float(&mut self, field: u32, value: f32) {
        self.fixed(field, 5, value.to_bits().to_le_bytes());
    }

    /// A `fixed32`.
    pub fn fixed32(&mut self, field: u32, value: u32) {
        self.fixed(field, 5, value.to_le_bytes());
    }

    /// Packed `float`s.
    pub fn floats(&mut self, field: u32, values: &[f32]) {
        self.key(field, 2);
        self.varint(4 * values.len() as u64);
        for value in values {
            self.out.extend_from_slice(&value.to_bits().to_le_bytes());
        }
    }

    /// `bytes`.
    pub fn bytes(&mut self, field: u32, value: &[u8]) {
        self.key(field, 2);
        self.varint(value.len() as u64);
        self.out.extend_from_slice(value);
    }

    /// A `string`.
    pub fn text(&mut self, field: u32, value: &str) {
        self.bytes(field, value.as_bytes());
    }

    /// A message inside of this one, whose fields `write` writes.
    pub fn message(&mut self, field: u32, write: impl FnOnce(&mut Encoder<'_>)) {
        self.key(field, 2);
        // Nearly all inner messages are shorter than 128 bytes, whose length takes one byte.
        let start = self.out.len();
        self.out.push(0);
        write(&mut Encoder { out: self.out });
        let end = self.out.len();
        let mut length = end - start - 1;
        if length < 0x80 {
            self.out[start] = length as u8;
            return;
        }
        let mut prefix = [0; 10];
        let mut size = 0;
        loop {
            prefix[size] = (length & 0x7f) as u8 | if length >= 0x80 { 0x80 } else { 0 };
            size += 1;
            length >>= 7;
            if length == 0 {
                break;
            }
        }
        self.out.resize(end + size - 1, 0);
        self.out.copy_within(start + 1..end, start + size);
        self.out[start..start + size].copy_from_slice(&prefix[..size]);
    }
}

/// A field's value, by its shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// Shape 0.
    Varint(u64),
    /// Shape 1.
    Fixed64(u64),
    /// Shape 2.
    Bytes(&'a [u8]),
    /// Shape 5.
    Fixed32(u32),
}

impl<'a> Value<'a> {
    fn wrong<T>(self, expected: &'static str) -> Result<T, WireError> {
        let found = match self {
            Value::Varint(_) => "a varint",
            Value::Fixed64(_) => "64 bits",
            Value::Bytes(_) => "bytes",
            Value::Fixed32(_) => "32 bits",
        };
        Err(WireError::Shape { expected, found })
    }

    /// A `uint64`.
    ///
    /// # Errors
    /// Another shape; so for all of these.
    pub fn uint(self) -> Result<u64, WireError> {
        if let Value::Varint(value) = self { Ok(value) } else { self.wrong("a varint") }
    }

    /// An `int64`.
    ///
    /// # Errors
    /// Another shape.
    pub fn int(self) -> Result<i64, WireError> {
        self.uint().map(|value| value as i64)
    }

    /// A `bool`.
    ///
    /// # Errors
    /// Another shape.
    pub fn bool(self) -> Result<bool, WireError> {
        self.uint().map(|value| value != 0)
    }

    /// An `sfixed64`.
    ///
    /// # Errors
    /// Another shape.
    pub fn sfixed64(self) -> Result<i64, WireError> {
        if let Value::Fixed64(value) = self { Ok(value as i64) } else { self.wrong("64 bits") }
    }

    /// A `double`.
    ///
    /// # Errors
    /// Another shape.
    pub fn double(self) -> Result<f64, WireError> {
        if let Value::Fixed64(value) = self { Ok(f64::from_bits(value)) } else { self.wrong("64 bits") }
    }

    /// A single-precision number that was written as a `double`.
    ///
    /// # Errors
    /// Another shape, or more bits than single precision holds.
    pub fn single(self) -> Result<f32, WireError> {
        let value = self.double()?;
        narrow(value).ok_or_else(|| WireError::Value {
            what: "a number in single precision",
            expected: "24 bits of mantissa",
            found: format!("{value:e}"),
        })
    }

    /// A `float`.
    ///
    /// # Errors
    /// Another shape.
    pub fn float(self) -> Result<f32, WireError> {
        if let Value::Fixed32(value) = self { Ok(f32::from_bits(value)) } else { self.wrong("32 bits") }
    }

    /// A `fixed32`.
    ///
    /// # Errors
    /// Another shape.
    pub fn fixed32(self) -> Result<u32, WireError> {
        if let Value::Fixed32(value) = self { Ok(value) } else { self.wrong("32 bits") }
    }

    /// `bytes`, or a message inside.
    ///
    /// # Errors
    /// Another shape.
    pub fn bytes(self) -> Result<&'a [u8], WireError> {
        if let Value::Bytes(value) = self { Ok(value) } else { self.wrong("bytes") }
    }

    /// A `string`.
    ///
    /// # Errors
    /// Another shape, or no UTF-8.
    pub fn text(self) -> Result<&'a str, WireError> {
        std::str::from_utf8(self.bytes()?).or(Err(WireError::Shape { expected: "text", found: "no UTF-8" }))
    }

    /// Packed `float`s, exactly `N`.
    ///
    /// # Errors
    /// Another shape or number.
    pub fn floats<const N: usize>(self) -> Result<[f32; N], WireError> {
        let bytes = self.bytes()?;
        if bytes.len() != 4 * N {
            return Err(WireError::Value {
                what: "a list of numbers",
                expected: "as many as the schema says",
                found: format!("{} bytes", bytes.len()),
            });
        }
        let mut values = [0.0; N];
        for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(4)) {
            *value = f32::from_bits(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        }
        Ok(values)
    }
}

/// Reads the fields of a message in the order in which they are there.
#[derive(Clone, Debug)]
pub struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Decoder<'a> {
    /// The fields of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// Nearly all tags and lengths are of one byte.
    #[inline]
    fn varint(&mut self) -> Result<u64, WireError> {
        match self.bytes.get(self.at) {
            Some(&byte) if byte < 0x80 => {
                self.at += 1;
                Ok(byte.into())
            }
            _ => self.long_varint(),
        }
    }

    fn long_varint(&mut self) -> Result<u64, WireError> {
        let start = self.at;
        let mut value = 0u64;
        for shift in (0..64).step_by(7) {
            let Some(&byte) = self.bytes.get(self.at) else {
                return Err(WireError::Short { at: self.at, expected: 1, found: 0 });
            };
            self.at += 1;
            let bits = u64::from(byte & 0x7f);
            if shift == 63 && bits > 1 {
                break;
            }
            value |= bits << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(WireError::Varint { at: start })
    }

    #[cold]
    fn short<T>(&self, expected: u64) -> Result<T, WireError> {
        Err(WireError::Short { at: self.at, expected, found: self.bytes.len() - self.at })
    }

    #[inline]
    fn take(&mut self, count: u64) -> Result<&'a [u8], WireError> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        match usize::try_from(count).ok().and_then(|count| rest.get(..count)) {
            Some(bytes) => {
                self.at += bytes.len();
                Ok(bytes)
            }
            None => self.short(count),
        }
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        match self.bytes.get(self.at..).and_then(|rest| rest.first_chunk()) {
            Some(bytes) => {
                self.at += N;
                Ok(*bytes)
            }
            None => self.short(N as u64),
        }
    }

    /// The next field's number and value; `None` at the end.
    ///
    /// # Errors
    /// Where the bytes are no message. Fields of unknown numbers are the caller's to pass over.
    #[inline]
    pub fn field(&mut self) -> Result<Option<(u32, Value<'a>)>, WireError> {
        if self.at == self.bytes.len() {
            return Ok(None);
        }
        let at = self.at;
        let tag = self.varint()?;
        let number = u32::try_from(tag >> 3).ok().filter(|&number| number != 0 && number < 1 << 29);
        let Some(number) = number else { return Err(WireError::Tag { at, tag }) };
        let value = match tag & 7 {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(u64::from_le_bytes(self.array()?)),
            2 => {
                let length = self.varint()?;
                Value::Bytes(self.take(length)?)
            }
            5 => Value::Fixed32(u32::from_le_bytes(self.array()?)),
            _ => return Err(WireError::Tag { at, tag }),
        };
        Ok(Some((number, value)))
    }

    /// Hands every field to `take`.
    ///
    /// # Errors
    /// Where the bytes are no message, or `take` refuses one.
    #[inline]
    pub fn each(
        mut self,
        mut take: impl FnMut(u32, Value<'a>) -> Result<(), WireError>,
    ) -> Result<(), WireError> {
        while let Some((number, value)) = self.field()? {
            take(number, value)?;
        }
        Ok(())
    }
}

/// The double-precision number with all bits of `single`: its value and sign, and for NaN its payload and whether it
/// signals (a cast would make it quiet).
pub(crate) fn widen(single: f32) -> f64 {
    if !single.is_nan() {
        return f64::from(single);
    }
    let bits = u64::from(single.to_bits());
    f64::from_bits((bits >> 31) << 63 | 0x7ff << 52 | (bits & 0x7f_ffff) << 29)
}

/// What [`widen`] was given; `None` for a number that is none of its results.
pub(crate) fn narrow(double: f64) -> Option<f32> {
    let single = if double.is_nan() {
        let bits = double.to_bits();
        f32::from_bits(((bits >> 63) << 31 | 0xff << 23 | (bits >> 29 & 0x7f_ffff)) as u32)
    } else {
        double as f32
    };
    (widen(single).to_bits() == double.to_bits()).then_some(single)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_bit_of_a_single_survives() {
        for bits in [0u32, 0x8000_0000, 0x7f80_0000, 0x7f80_0001, 0xffc1_2345, 0x7fff_ffff, 1, 0x807f_ffff] {
            let single = f32::from_bits(bits);
            assert_eq!(narrow(widen(single)).unwrap().to_bits(), bits, "{bits:x}");
        }
        assert_eq!(narrow(0.1f64), None);
        assert_eq!(narrow(1e300), None);
    }

    #[test]
    fn inner_messages_of_any_length_have_the_shortest_prefix() {
        for length in [0usize, 1, 124, 125, 126, 127, 128, 16_380, 16_384, 70_000] {
            let mut out = Vec::new();
            Encoder::new(&mut out).message(3, |inner| inner.bytes(1, &vec![7; length]));
            let mut decoder = Decoder::new(&out);
            let (number, value) = decoder.field().unwrap().unwrap();
            assert_eq!((number, decoder.field().unwrap()), (3, None));
            let mut inner = Decoder::new(value.bytes().unwrap());
            assert_eq!(inner.field().unwrap().unwrap().1.bytes().unwrap().len(), length);
        }
    }

    proptest! {
        #[test]
        fn numbers_come_back(bits in any::<u64>(), small in any::<u32>(), int in any::<i64>()) {
            let mut out = Vec::new();
            let mut encoder = Encoder::new(&mut out);
            encoder.double(1, f64::from_bits(bits));
            encoder.double_of(2, f32::from_bits(small));
            encoder.int(3, int);
            encoder.sfixed64(70_000, int);
            encoder.float(5, f32::from_bits(small));
            encoder.floats(6, &[f32::from_bits(small), -0.0]);
            let mut decoder = Decoder::new(&out);
            let mut next = || decoder.field().unwrap().unwrap();
            prop_assert_eq!(next().1.double().unwrap().to_bits(), bits);
            prop_assert_eq!(next().1.single().unwrap().to_bits(), small);
            prop_assert_eq!(next().1.int().unwrap(), int);
            prop_assert_eq!(next(), (70_000, Value::Fixed64(int as u64)));
            prop_assert_eq!(next().1.float().unwrap().to_bits(), small);
            prop_assert_eq!(next().1.floats::<2>().unwrap().map(f32::to_bits), [small, 0x8000_0000]);
        }

        #[test]
        fn any_bytes_are_a_message_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut decoder = Decoder::new(&bytes);
            while let Ok(Some(_)) = decoder.field() {}
        }
    }
}
