//! `--tiles`, `--samples` and `--shard`: what one machine of many does of a picture, or of a build.

use trex_store::build::shards::SHARDS;

/// `--tiles I/N`: share I of N, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileShare {
    /// From 1 to `count`.
    pub number: u32,
    /// Shares in all.
    pub count: u32,
}

/// `--shard I/N`: shard I of N, counted from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShardNumber {
    /// From 1 to `count`.
    pub number: u32,
    /// Shards in all.
    pub count: u32,
}

/// `--samples A..B`: from A, counted from 0, to the one before B.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleRange {
    /// The first.
    pub first: u32,
    /// The one behind the last, greater than the first.
    pub end: u32,
}

/// Parses a share: `1/8` to `8/8`.
pub fn tile_share(text: &str) -> Result<TileShare, String> {
    let share = share(text).map(|(number, count)| TileShare { number, count });
    share.ok_or_else(|| "accepted is a share of all tiles, counted from 1: 1/8 to 8/8".to_owned())
}

/// Parses the number of a shard: `1/8` to `8/8`.
pub fn shard_number(text: &str) -> Result<ShardNumber, String> {
    let shard = share(text).filter(|&(_, count)| count <= SHARDS);
    shard
        .map(|(number, count)| ShardNumber { number, count })
        .ok_or_else(|| format!("accepted is a shard of up to {SHARDS}, counted from 1: 1/8 to 8/8"))
}

/// A number from 1 to a count, and this.
fn share(text: &str) -> Option<(u32, u32)> {
    let (number, count) = text.trim().split_once('/')?;
    let (number, count) = (number.parse().ok()?, count.parse().ok()?);
    (1..=count).contains(&number).then_some((number, count))
}

/// Parses a range of samples: `0..4`.
pub fn sample_range(text: &str) -> Result<SampleRange, String> {
    let range = text
        .trim()
        .split_once("..")
        .and_then(|(first, end)| Some(SampleRange { first: first.parse().ok()?, end: end.parse().ok()? }));
    range
        .filter(|range| range.first < range.end)
        .ok_or_else(|| "accepted is a range of samples, counted from 0, without its end: 0..4".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_count_from_1() {
        assert_eq!(tile_share("3/8"), Ok(TileShare { number: 3, count: 8 }));
        assert_eq!(tile_share("1/1"), Ok(TileShare { number: 1, count: 1 }));
        for text in ["", "3", "0/8", "9/8", "1/0", "-1/8", "1/8/2", "a/b", "5000000000/5000000001"] {
            assert!(tile_share(text).is_err(), "{text}");
        }
    }

    #[test]
    fn shards_are_not_without_bound() {
        assert_eq!(shard_number("512/512"), Ok(ShardNumber { number: 512, count: 512 }));
        for text in ["", "1", "0/2", "3/2", "1/513", "1/4294967295"] {
            assert!(shard_number(text).is_err(), "{text}");
        }
    }

    #[test]
    fn ranges_of_samples_are_not_empty() {
        assert_eq!(sample_range("0..4"), Ok(SampleRange { first: 0, end: 4 }));
        for text in ["", "4", "4..4", "5..4", "..4", "4..", "0..=4", "-1..4", "0..5000000000"] {
            assert!(sample_range(text).is_err(), "{text}");
        }
    }
}
