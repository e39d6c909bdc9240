//! Report descriptors: what the bytes of a device's reports mean, by the device's own word.
//!
//! `hidreport` parses them; what it must be kept from (it allocates what a hostile count asks for, and panics on some
//! damage) is checked before, and reading a field out of a report is done here, within bounds.

use std::panic::{AssertUnwindSafe, catch_unwind};

use hidreport::{Field, Report, ReportDescriptor};

/// The kernel passes on no more.
const MOST_BYTES: usize = 4096;
/// Of all reports together; a keyboard has 200, a pad with everything 400.
const MOST_FIELDS: u64 = 8192;
/// Of one main item, and of all: the parser lists each usage of a range.
const MOST_USAGES: (u64, u64) = (1 << 16, 1 << 20);
/// Of collections in collections, and of usages of one, which the parser copies into each field.
const DEEPEST: u32 = 32;
const MOST_USAGES_OF_COLLECTION: u64 = 32;
/// Of one report, as of the kernel's buffers.
const MOST_REPORT_BITS: u64 = 16384 * 8;

/// What a device's input reports look like.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// One for each report number.
    pub reports: Vec<ReportLayout>,
}

/// One kind of report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReportLayout {
    /// The number that its first byte is, where the device has several kinds.
    pub id: Option<u8>,
    /// Length with that byte.
    pub bytes: usize,
    /// In the order of the report; constants are left out, and lists of pressed keys.
    pub fields: Vec<FieldLayout>,
}

/// One number of a report.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldLayout {
    /// What it means: usage page and usage.
    pub usage: (u16, u16),
    /// The usages of the collections that it stands in, innermost last.
    pub within: Vec<(u16, u16)>,
    /// Where.
    pub slot: Slot,
    /// The least and the greatest number that it can be.
    pub logical: (i32, i32),
    /// The number times ten to this is the value.
    pub exponent: i8,
    /// As in the descriptor; 0 for the usage's own unit.
    pub unit: u32,
}

/// How bits are a number; the least significant come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Number {
    /// Without a sign.
    Unsigned,
    /// Two's complement.
    Signed,
    /// IEEE, 32 or 64 bits.
    Float,
}

/// Where a number is in a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// First bit, counted from the report's beginning.
    pub bit: usize,
    /// How many: 1 to 64.
    pub bits: usize,
    /// How they are a number.
    pub number: Number,
}

impl Slot {
    /// The bits as they are; `None` where the report is too short.
    pub fn raw(&self, report: &[u8]) -> Option<u64> {
        if self.bits == 0 || self.bits > 64 || report.len() * 8 < self.bit + self.bits {
            return None;
        }
        let (first, shift) = (self.bit / 8, self.bit % 8);
        let last = (self.bit + self.bits).div_ceil(8);
        // 64 bits from any bit on touch nine bytes.
        let wide = report[first..last].iter().rev().fold(0u128, |all, &byte| all << 8 | u128::from(byte));
        let mask = u64::MAX >> (64 - self.bits);
        Some((wide >> shift) as u64 & mask)
    }

    /// The number; `None` where the report is too short.
    pub fn read(&self, report: &[u8]) -> Option<f64> {
        let raw = self.raw(report)?;
        Some(match (self.number, self.bits) {
            (Number::Unsigned, _) => raw as f64,
            (Number::Signed, bits) => ((raw << (64 - bits)) as i64 >> (64 - bits)) as f64,
            (Number::Float, 32) => f64::from(f32::from_bits(raw as u32)),
            (Number::Float, 64) => f64::from_bits(raw),
            (Number::Float, _) => return None,
        })
    }
}

/// Whether a parser can be let loose on it; why not.
fn check(bytes: &[u8]) -> Result<(), String> {
    if bytes.len() > MOST_BYTES {
        return Err(format!("{} bytes", bytes.len()));
    }
    let (mut size, mut count, mut report, mut stack) = (0u64, 0u64, 0u64, Vec::new());
    let (mut fields, mut report_bits) = (0u64, std::collections::BTreeMap::<u64, u64>::new());
    // Of the next main item: the range of its usages, and how many are listed.
    let (mut first_usage, mut last_usage, mut listed) = (None::<u64>, None::<u64>, 0u64);
    let (mut usages, mut depth) = (0u64, 0u32);
    let mut at = 0;
    while let Some(&head) = bytes.get(at) {
        if head == 0xFE {
            return Err(format!("a long item at byte {at}"));
        }
        let length = [0, 1, 2, 4][usize::from(head & 3)];
        let Some(data) = bytes.get(at + 1..at + 1 + length) else {
            return Err(format!("an item that is cut off at byte {at}"));
        };
        let value = data.iter().rev().fold(0u64, |all, &byte| all << 8 | u64::from(byte));
        match head & 0xFC {
            0x74 => size = value,
            0x94 => count = value,
            0x84 => report = value,
            0x08 => listed += 1,
            0x18 => first_usage = Some(value),
            0x28 => last_usage = Some(value),
            0xC0 => depth = depth.saturating_sub(1),
            // The parser keeps what belongs to the next main item, too.
            0xA4 if stack.len() < 16 => {
                stack.push((size, count, report, first_usage, last_usage, listed));
            }
            0xA4 => return Err("more than 16 pushes".into()),
            0xB4 => match stack.pop() {
                Some(pushed) => (size, count, report, first_usage, last_usage, listed) = pushed,
                None => return Err(format!("a pop without a push at byte {at}")),
            },
            // Input, output, feature, collection.
            kind @ (0x80 | 0x90 | 0xB0 | 0xA0) => {
                let range = match (first_usage, last_usage) {
                    (Some(first), Some(last)) => (last + 1).saturating_sub(first),
                    _ => 0,
                };
                usages += range;
                if range > MOST_USAGES.0 || usages > MOST_USAGES.1 {
                    return Err(format!("{usages} usages, at byte {at}"));
                }
                if kind == 0xA0 {
                    depth += 1;
                    if depth > DEEPEST || range.max(listed) > MOST_USAGES_OF_COLLECTION {
                        let many = range.max(listed);
                        return Err(format!(
                            "{depth} collections in one another, {many} usages of one, at byte {at}"
                        ));
                    }
                }
                // Products of 32-bit numbers fit. A collection has none.
                let count = if kind == 0xA0 { 0 } else { count };
                fields += count;
                let bits = report_bits.entry(u64::from(kind) << 32 | report).or_default();
                *bits = bits.saturating_add(size * count);
                if fields > MOST_FIELDS || *bits > MOST_REPORT_BITS {
                    return Err(format!("{fields} fields, {bits} bits in one report, at byte {at}"));
                }
            }
            _ => {}
        }
        // Those ended what belongs to the next one.
        if matches!(head & 0xFC, 0x80 | 0x90 | 0xA0 | 0xB0 | 0xC0) {
            (first_usage, last_usage, listed) = (None, None, 0);
        }
        at += 1 + length;
    }
    Ok(())
}

/// The range of a field. Where no number is negative, a maximum that looks so was meant without a sign: `25 FF`, of eight bits, is
/// 255 for the kernel, and in a great many descriptors.
fn logical(least: i32, most: i32, bits: usize) -> (i32, i32) {
    if least < 0 || most >= least {
        return (least, most);
    }
    let written = match most {
        -128..0 => 8,
        -32_768..-128 => 16,
        _ => 32,
    };
    // Of ones only it cannot be seen how many were written: as many as the field has, if those are few.
    let bits = if most == -1 { bits.clamp(8, 32) } else { written };
    let most = i64::from(most) & (i64::from(u32::MAX) >> (32 - bits));
    (least, i32::try_from(most).unwrap_or(i32::MAX))
}

impl Layout {
    /// From a report descriptor.
    ///
    /// # Errors
    /// What was found where a descriptor, within the limits of the kernel, was expected.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        check(bytes)?;
        let parsed = catch_unwind(AssertUnwindSafe(|| Self::parse_checked(bytes)));
        parsed.unwrap_or_else(|_| Err("a descriptor that the parser gives up on".into()))
    }

    fn parse_checked(bytes: &[u8]) -> Result<Self, String> {
        let descriptor = ReportDescriptor::try_from(bytes).map_err(|error| error.to_string())?;
        let mut reports = Vec::new();
        for report in descriptor.input_reports() {
            let id = report.report_id().as_ref().map(u8::from);
            let mut fields = Vec::new();
            for field in report.fields() {
                let Field::Variable(field) = field else { continue };
                let bits = field.bits.len();
                if bits == 0 || bits > 64 {
                    continue;
                }
                let number = if field.is_signed() { Number::Signed } else { Number::Unsigned };
                let usage =
                    |usage: &hidreport::Usage| (u16::from(usage.usage_page), u16::from(usage.usage_id));
                fields.push(FieldLayout {
                    usage: usage(&field.usage),
                    within: field.collections.iter().filter_map(|c| c.usages().first().map(usage)).collect(),
                    slot: Slot { bit: field.bits.start, bits, number },
                    logical: logical(
                        i32::from(field.logical_minimum),
                        i32::from(field.logical_maximum),
                        bits,
                    ),
                    exponent: field.unit_exponent.as_ref().map_or(0, |exponent| exponent.exponent()),
                    unit: field.unit.as_ref().map_or(0, u32::from),
                });
            }
            reports.push(ReportLayout { id, bytes: report.size_in_bits().div_ceil(8), fields });
        }
        Ok(Self { reports })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// HID sensor page: an accelerometer, three times 16 bits in hundredths of g, as in the HID sensor usage tables.
    pub(crate) const ACCELEROMETER: [u8; 47] = [
        0x05, 0x20, 0x09, 0x73, 0xA1, 0x01, 0x85, 0x01, 0x16, 0x01, 0x80, 0x26, 0xFF, 0x7F, 0x75, 0x10, 0x95,
        0x01, 0x55, 0x0E, 0x0A, 0x53, 0x04, 0x81, 0x02, 0x0A, 0x54, 0x04, 0x81, 0x02, 0x0A, 0x55, 0x04, 0x81,
        0x02, 0x0A, 0x29, 0x05, 0x15, 0x00, 0x75, 0x20, 0x55, 0x00, 0x81, 0x02, 0xC0,
    ];

    #[test]
    fn a_sensor_describes_itself() {
        let layout = Layout::parse(&ACCELEROMETER).unwrap();
        let report = &layout.reports[0];
        assert_eq!((report.id, report.bytes, report.fields.len()), (Some(1), 11, 4));
        let x = &report.fields[0];
        assert_eq!((x.usage, x.exponent, x.slot.bit, x.slot.bits), ((0x20, 0x0453), -2, 8, 16));
        assert_eq!(x.within, [(0x20, 0x73)]);
        let bytes = [1, 0xFE, 0xFF, 0, 0, 100, 0, 1, 0, 0, 0];
        let values: Vec<_> = report.fields.iter().map(|field| field.slot.read(&bytes)).collect();
        assert_eq!(values, [Some(-2.0), Some(0.0), Some(100.0), Some(1.0)]);
        assert_eq!(report.fields[2].slot.read(&bytes[..6]), None);
    }

    #[test]
    fn a_maximum_that_was_written_without_a_sign_is_one() {
        assert_eq!(logical(0, -1, 8), (0, 255));
        assert_eq!(logical(0, -1, 10), (0, 1023));
        assert_eq!(logical(0, -1, 16), (0, 65_535));
        assert_eq!(logical(0, -24, 16), (0, 232));
        assert_eq!(logical(0, i32::from(-30_000i16), 16), (0, 35_536));
        assert_eq!(logical(-127, 127, 8), (-127, 127));
        assert_eq!(logical(0, -1, 32), (0, i32::MAX));
    }

    #[test]
    fn numbers_are_read_at_any_bit() {
        let bytes = 0xFEDC_BA98_7654_3210_u64.to_le_bytes();
        let slot = |bit, bits, number| Slot { bit, bits, number };
        assert_eq!(slot(4, 8, Number::Unsigned).raw(&bytes), Some(0x21));
        assert_eq!(slot(60, 4, Number::Signed).read(&bytes), Some(-1.0));
        assert_eq!(slot(0, 64, Number::Unsigned).raw(&bytes), Some(0xFEDC_BA98_7654_3210));
        let shifted: Vec<u8> = (0xFEDC_BA98_7654_3210_u128 << 5).to_le_bytes()[..9].to_vec();
        assert_eq!(slot(5, 64, Number::Unsigned).raw(&shifted), Some(0xFEDC_BA98_7654_3210));
        assert_eq!(slot(1, 64, Number::Unsigned).raw(&bytes), None);
        assert_eq!(slot(0, 32, Number::Float).read(&1.5f32.to_le_bytes()), Some(1.5));
    }

    #[test]
    fn what_would_take_the_memory_is_refused() {
        // Report Count 2^32 − 1.
        let hostile = [0x05, 0x01, 0x09, 0x30, 0x75, 0x20, 0x97, 0xFF, 0xFF, 0xFF, 0xFF, 0x81, 0x02];
        assert!(Layout::parse(&hostile).unwrap_err().contains("fields"));
        // Usages 0 to 2^32 − 1.
        let range =
            [0x05, 0x01, 0x19, 0x00, 0x2B, 0xFF, 0xFF, 0xFF, 0xFF, 0x75, 0x08, 0x95, 0x01, 0x81, 0x02];
        assert!(Layout::parse(&range).unwrap_err().contains("usages"));
        // A collection with 2^16 usages, around 8,000 fields.
        let wide = [
            0x05, 0x01, 0x19, 0x00, 0x2A, 0xFF, 0xFF, 0xA1, 0x01, 0x09, 0x30, 0x75, 0x08, 0x96, 0x40, 0x1F,
            0x81, 0x02,
        ];
        assert!(Layout::parse(&wide).unwrap_err().contains("65536 usages of one"));
        let deep: Vec<u8> = [0x05, 0x01, 0x09, 0x30].into_iter().chain([0xA1, 0x00].repeat(33)).collect();
        assert!(Layout::parse(&deep).unwrap_err().contains("collections"));
        for hostile in [vec![0x05], vec![0xFE, 1, 1, 1], vec![0xB4], vec![0xA4; 40], vec![0; 5000]] {
            assert!(Layout::parse(&hostile).is_err(), "{hostile:?}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

        /// Damage to a real descriptor, and reports of any length: an error or a layout, never a panic that gets out.
        #[test]
        fn damage_is_survived(changes in prop::collection::vec((0usize..47, any::<u8>()), 1..4), report: Vec<u8>) {
            let mut bytes = ACCELEROMETER;
            for (at, byte) in changes {
                bytes[at] = byte;
            }
            let hook = std::panic::take_hook();
            std::panic::set_hook(Box::new(|_| {}));
            let layout = Layout::parse(&bytes);
            std::panic::set_hook(hook);
            for field in layout.unwrap_or_default().reports.iter().flat_map(|report| &report.fields) {
                let _ = field.slot.read(&report);
            }
        }
    }
}
