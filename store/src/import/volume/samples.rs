//! The types of samples: their names, their order, and the numbers that they are.
//!
//! Invariant: whether a sample is inside of a surface is decided in its own type, by the least sample that is not below
//! the value, so that no conversion moves it across.

use crate::import::scalar::ByteOrder;
use bytemuck::Pod;

/// The type of a volume's samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SampleType {
    /// 8 bits, signed.
    Int8,
    /// 8 bits, unsigned.
    Uint8,
    /// 16 bits, signed.
    Int16,
    /// 16 bits, unsigned.
    Uint16,
    /// 32 bits, signed.
    Int32,
    /// 32 bits, unsigned.
    Uint32,
    /// 64 bits, signed.
    Int64,
    /// 64 bits, unsigned.
    Uint64,
    /// IEEE 754, 32 bits.
    Float32,
    /// IEEE 754, 64 bits.
    Float64,
}

/// All types, with the names that people, NRRD and MetaImage have for them.
const NAMES: [(SampleType, &[&str]); 10] = [
    (SampleType::Int8, &["int8", "int8_t", "signed char", "char", "met_char"]),
    (SampleType::Uint8, &["uint8", "uint8_t", "uchar", "unsigned char", "met_uchar"]),
    (
        SampleType::Int16,
        &["int16", "int16_t", "short", "short int", "signed short", "signed short int", "met_short"],
    ),
    (
        SampleType::Uint16,
        &["uint16", "uint16_t", "ushort", "unsigned short", "unsigned short int", "met_ushort"],
    ),
    // MetaImage's long has 32 bits on every machine.
    (SampleType::Int32, &["int32", "int32_t", "int", "signed int", "met_int", "met_long"]),
    (SampleType::Uint32, &["uint32", "uint32_t", "uint", "unsigned int", "met_uint", "met_ulong"]),
    (
        SampleType::Int64,
        &[
            "int64",
            "int64_t",
            "longlong",
            "long long",
            "long long int",
            "signed long long",
            "signed long long int",
            "met_long_long",
        ],
    ),
    (
        SampleType::Uint64,
        &[
            "uint64",
            "uint64_t",
            "ulonglong",
            "unsigned long long",
            "unsigned long long int",
            "met_ulong_long",
        ],
    ),
    (SampleType::Float32, &["float32", "float", "met_float"]),
    (SampleType::Float64, &["float64", "double", "met_double"]),
];

impl SampleType {
    /// The type of this name, as people, NRRD and MetaImage call it, in any case.
    pub fn from_name(name: &str) -> Option<SampleType> {
        let name = name.to_ascii_lowercase();
        NAMES.iter().find(|(_, names)| names.contains(&name.as_str())).map(|&(sample, _)| sample)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        NAMES[self as usize].1[0]
    }

    /// Bytes of a sample.
    pub fn bytes(self) -> u64 {
        match self {
            SampleType::Int8 | SampleType::Uint8 => 1,
            SampleType::Int16 | SampleType::Uint16 => 2,
            SampleType::Int32 | SampleType::Uint32 | SampleType::Float32 => 4,
            SampleType::Int64 | SampleType::Uint64 | SampleType::Float64 => 8,
        }
    }
}

/// A sample, as it lies in memory.
pub(super) trait Sample: Pod + PartialOrd + Send {
    /// With its bytes in the other order.
    fn swapped(self) -> Self;

    /// The number that it is; 64-bit integers are rounded.
    fn number(self) -> f64;

    /// False for NaN and infinities.
    fn is_number(self) -> bool;

    /// The least sample that is not below `value`, which is finite; `None` where there is none.
    fn least_from(value: f64) -> Option<Self>;
}

macro_rules! integers {
    ($($type:ty),*) => {$(
        impl Sample for $type {
            #[inline]
            fn swapped(self) -> $type {
                self.swap_bytes()
            }

            #[inline]
            fn number(self) -> f64 {
                self as f64
            }

            #[inline]
            fn is_number(self) -> bool {
                true
            }

            fn least_from(value: f64) -> Option<$type> {
                // A power of two: exact where the greatest value is not.
                let beyond = (<$type>::MAX / 2 + 1) as f64 * 2.0;
                let least = value.ceil();
                (least < beyond).then_some(least as $type)
            }
        }
    )*};
}

integers! { i8, u8, i16, u16, i32, u32, i64, u64 }

impl Sample for f32 {
    #[inline]
    fn swapped(self) -> f32 {
        f32::from_bits(self.to_bits().swap_bytes())
    }

    #[inline]
    fn number(self) -> f64 {
        f64::from(self)
    }

    #[inline]
    fn is_number(self) -> bool {
        self.is_finite()
    }

    fn least_from(value: f64) -> Option<f32> {
        let nearest = value as f32;
        Some(if f64::from(nearest) < value { nearest.next_up() } else { nearest })
    }
}

impl Sample for f64 {
    #[inline]
    fn swapped(self) -> f64 {
        f64::from_bits(self.to_bits().swap_bytes())
    }

    #[inline]
    fn number(self) -> f64 {
        self
    }

    #[inline]
    fn is_number(self) -> bool {
        self.is_finite()
    }

    fn least_from(value: f64) -> Option<f64> {
        Some(value)
    }
}

/// Whether samples of this order have to be swapped on this machine.
pub(super) fn is_foreign(order: ByteOrder) -> bool {
    (order == ByteOrder::Big) == cfg!(target_endian = "little")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_type_has_its_own_first_name() {
        for (at, (sample, names)) in NAMES.iter().enumerate() {
            assert_eq!((*sample as usize, sample.name()), (at, names[0]));
            assert!(names.iter().all(|name| SampleType::from_name(&name.to_uppercase()) == Some(*sample)));
        }
    }

    #[test]
    fn the_least_sample_inside_is_exact() {
        assert_eq!([-0.5, 60.0, 60.1, 255.0].map(u8::least_from), [Some(0), Some(60), Some(61), Some(255)]);
        assert_eq!(
            (u8::least_from(255.1), i8::least_from(127.5), i8::least_from(-1e9)),
            (None, None, Some(-128))
        );
        assert_eq!((i64::least_from(2f64.powi(63)), u64::least_from(2f64.powi(64))), (None, None));
        assert_eq!(i64::least_from(-(2f64.powi(63))), Some(i64::MIN));
        // 0.1 lies above f64's 0.1 in f32, 0.3 too, 0.7 below.
        for value in [0.1, 0.3, 0.7, -0.7, 1e-50, 1e300, -1e300] {
            let least = f32::least_from(value).unwrap();
            assert!(f64::from(least) >= value && f64::from(least.next_down()) < value, "{value}: {least}");
        }
    }
}
