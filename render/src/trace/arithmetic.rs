//! `Arithmetic`: which kernel traces the rays of a file.

use trex_store::PageFile;
use trex_store::layout::NARROW_BITS;

/// The arithmetic that traces the rays of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arithmetic {
    /// AVX2 and FMA, f32.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Portable, f32: gives the same bits as AVX2.
    Scalar,
    /// Portable, f64: for lattices of more than 24 bits.
    Deep,
}

impl Arithmetic {
    /// The fastest arithmetic that this machine and the lattice of `file` allow.
    pub fn for_file(file: &PageFile) -> Arithmetic {
        if file.superblock().lattice_bits > NARROW_BITS {
            return Arithmetic::Deep;
        }
        #[cfg(target_arch = "x86_64")]
        if super::simd::is_available() {
            return Arithmetic::Avx2;
        }
        Arithmetic::Scalar
    }

    /// Panics where the arithmetic does not fit the file or the machine.
    pub(super) fn check(self, file: &PageFile) {
        assert!(self == Arithmetic::Deep || file.superblock().lattice_bits <= NARROW_BITS);
        #[cfg(target_arch = "x86_64")]
        assert!(self != Arithmetic::Avx2 || super::simd::is_available());
    }

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Arithmetic::Avx2 => "avx2",
            Arithmetic::Scalar => "scalar",
            Arithmetic::Deep => "scalar-f64",
        }
    }
}
