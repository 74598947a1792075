//! `Scalar`: the number types of binary mesh files.
//!
//! Invariant: every type but f64 and the 32-bit integers is held by f32 without loss, and all by f64.

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// Least byte first.
    Little,
    /// Greatest byte first.
    Big,
}

/// A number type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scalar {
    /// `char`, `int8`
    I8,
    /// `uchar`, `uint8`
    U8,
    /// `short`, `int16`
    I16,
    /// `ushort`, `uint16`
    U16,
    /// `int`, `int32`
    I32,
    /// `uint`, `uint32`
    U32,
    /// `float`, `float32`
    F32,
    /// `double`, `float64`
    F64,
}

impl Scalar {
    /// The type that a PLY header calls `name`.
    pub(super) fn from_ply_name(name: &str) -> Option<Scalar> {
        Some(match name {
            "char" | "int8" => Scalar::I8,
            "uchar" | "uint8" => Scalar::U8,
            "short" | "int16" => Scalar::I16,
            "ushort" | "uint16" => Scalar::U16,
            "int" | "int32" => Scalar::I32,
            "uint" | "uint32" => Scalar::U32,
            "float" | "float32" => Scalar::F32,
            "double" | "float64" => Scalar::F64,
            _ => return None,
        })
    }

    /// Bytes of a number.
    pub(super) fn size(self) -> usize {
        match self {
            Scalar::I8 | Scalar::U8 => 1,
            Scalar::I16 | Scalar::U16 => 2,
            Scalar::I32 | Scalar::U32 | Scalar::F32 => 4,
            Scalar::F64 => 8,
        }
    }

    /// True for all but the two floating-point types.
    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Scalar::F32 | Scalar::F64)
    }

    /// True when f32 holds every value.
    pub(super) fn fits_f32(self) -> bool {
        !matches!(self, Scalar::I32 | Scalar::U32 | Scalar::F64)
    }

    /// The number that `bytes` begins with.
    #[inline]
    pub(super) fn number(self, bytes: &[u8], order: ByteOrder) -> f64 {
        match self {
            Scalar::F32 => f64::from(f32::from_bits(u32::from_order(head(bytes), order))),
            Scalar::F64 => f64::from_bits(u64::from_order(head(bytes), order)),
            integer => integer.integer(bytes, order) as f64,
        }
    }

    /// A channel of a colour of this type, as a byte: integers of 8 bits as they are, wider ones by their share of
    /// 65535, fractions from 0 to 1.
    pub(super) fn channel(self, value: f64) -> u8 {
        let share = match self {
            Scalar::U8 | Scalar::I8 => value / 255.0,
            Scalar::F32 | Scalar::F64 => value,
            _ => value / 65535.0,
        };
        // What is no number counts as 0.
        (share * 255.0).round().clamp(0.0, 255.0) as u8
    }

    /// The integer that `bytes` begins with. For integer types only.
    #[inline]
    pub(super) fn integer(self, bytes: &[u8], order: ByteOrder) -> i64 {
        match self {
            Scalar::I8 => i64::from(bytes[0] as i8),
            Scalar::U8 => i64::from(bytes[0]),
            Scalar::I16 => i64::from(u16::from_order(head(bytes), order) as i16),
            Scalar::U16 => i64::from(u16::from_order(head(bytes), order)),
            Scalar::I32 => i64::from(u32::from_order(head(bytes), order) as i32),
            Scalar::U32 => i64::from(u32::from_order(head(bytes), order)),
            Scalar::F32 | Scalar::F64 => {
                unreachable!("the header has been checked: counts and indices are integers")
            }
        }
    }
}

/// Unsigned integers from bytes in either order.
pub(super) trait FromOrder<const N: usize>: Sized {
    /// The integer that `bytes` hold.
    fn from_order(bytes: [u8; N], order: ByteOrder) -> Self;
}

macro_rules! from_order {
    ($($type:ty, $size:literal;)*) => {$(
        impl FromOrder<$size> for $type {
            #[inline]
            fn from_order(bytes: [u8; $size], order: ByteOrder) -> $type {
                match order {
                    ByteOrder::Little => <$type>::from_le_bytes(bytes),
                    ByteOrder::Big => <$type>::from_be_bytes(bytes),
                }
            }
        }
    )*};
}

from_order! { u16, 2; u32, 4; u64, 8; }

/// The first `N` bytes.
#[inline]
pub(super) fn head<const N: usize>(bytes: &[u8]) -> [u8; N] {
    *bytes.first_chunk().expect("the caller has brought the whole number")
}
