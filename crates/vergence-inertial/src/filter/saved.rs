//! States as bytes: saved in mid-run, restored and continued bit for bit.

use nalgebra::{Quaternion, SMatrix, UnitQuaternion};
use vergence_time::Timestamp;

/// What can be written as bytes and read back equal in every bit (also NaN and −0).
pub trait Saved: Sized {
    /// Appends the value.
    fn put(&self, out: &mut Vec<u8>);
    /// Takes the value from the front; `None` where the bytes end or mean nothing.
    fn take(from: &mut &[u8]) -> Option<Self>;
}

impl Saved for u64 {
    fn put(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.to_le_bytes());
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        let (first, rest) = from.split_first_chunk::<8>()?;
        *from = rest;
        Some(Self::from_le_bytes(*first))
    }
}

impl Saved for f64 {
    fn put(&self, out: &mut Vec<u8>) {
        self.to_bits().put(out);
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        u64::take(from).map(Self::from_bits)
    }
}

impl Saved for bool {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(u8::from(*self));
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        let (first, rest) = from.split_first()?;
        *from = rest;
        match first {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }
    }
}

impl Saved for Timestamp {
    fn put(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.as_nanos().to_le_bytes());
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        let (first, rest) = from.split_first_chunk::<8>()?;
        *from = rest;
        Some(Self::from_nanos(i64::from_le_bytes(*first)))
    }
}

impl<T: Saved> Saved for Option<T> {
    fn put(&self, out: &mut Vec<u8>) {
        self.is_some().put(out);
        if let Some(value) = self {
            value.put(out);
        }
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        Some(if bool::take(from)? { Some(T::take(from)?) } else { None })
    }
}

impl<T: Saved + Copy + Default, const N: usize> Saved for [T; N] {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        let mut all = [T::default(); N];
        for value in &mut all {
            *value = T::take(from)?;
        }
        Some(all)
    }
}

impl<const R: usize, const C: usize> Saved for SMatrix<f64, R, C> {
    fn put(&self, out: &mut Vec<u8>) {
        self.iter().for_each(|value| value.put(out));
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        let mut all = Self::zeros();
        for value in all.iter_mut() {
            *value = f64::take(from)?;
        }
        Some(all)
    }
}

impl Saved for UnitQuaternion<f64> {
    fn put(&self, out: &mut Vec<u8>) {
        self.coords.put(out);
    }
    fn take(from: &mut &[u8]) -> Option<Self> {
        // Not normalised again: that could change the last bit.
        Some(Self::new_unchecked(Quaternion::from(SMatrix::<f64, 4, 1>::take(from)?)))
    }
}

/// Implements [`Saved`] for a struct, field by field; forgetting a field does not compile.
macro_rules! saved {
    ($name:ident { $($field:ident),* $(,)? }) => {
        impl $crate::filter::saved::Saved for $name {
            fn put(&self, out: &mut Vec<u8>) {
                let Self { $($field),* } = self;
                $($crate::filter::saved::Saved::put($field, out);)*
            }
            fn take(from: &mut &[u8]) -> Option<Self> {
                Some(Self { $($field: $crate::filter::saved::Saved::take(from)?),* })
            }
        }
    };
}
pub(crate) use saved;
