//! What criterion's benches measured last: medians, read from the folder where criterion keeps them.
//!
//! ```text
//! cargo bench -p trex-benches -> target/criterion/../new/{benchmark,estimates}.json -> medians of one model
//! ```
//!
//! Invariant: benches are named BENCH/MODEL/WHAT.., which `bench/benches/` keeps to.

use anyhow::{Context, ensure};
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::fs;
use std::path::Path;

/// Medians of one model, by bench and by what is measured.
#[derive(Debug, Serialize)]
pub struct Estimates {
    /// The model's name in the benches.
    pub scene: String,
    /// `traversal`, `closest`, `packets` and so on, down to `ns`, of one ray, or `bytes_per_s`.
    #[serde(flatten)]
    pub medians: Map<String, Value>,
}

/// Reads the medians of `model` in criterion's `folder`.
///
/// # Errors
/// The folder cannot be read, or has nothing of the model.
pub fn read(folder: &Path, model: &str) -> anyhow::Result<Estimates> {
    let mut estimates = Estimates { scene: model.to_owned(), medians: Map::new() };
    estimates.add_below(folder)?;
    ensure!(!estimates.medians.is_empty(), "{} has no bench of {model}: run cargo bench", folder.display());
    Ok(estimates)
}

impl Estimates {
    fn add_below(&mut self, folder: &Path) -> anyhow::Result<()> {
        let entries = fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
        for entry in entries {
            let path = entry?.path();
            if path.file_name().is_some_and(|name| name == "new") {
                self.add(&path)?;
            } else if path.is_dir() {
                self.add_below(&path)?;
            }
        }
        Ok(())
    }

    /// Adds what one bench came to, if it is of the model.
    fn add(&mut self, folder: &Path) -> anyhow::Result<()> {
        let document = |name: &str| -> anyhow::Result<Value> {
            let path = folder.join(name);
            let text =
                fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
            serde_json::from_str(&text).with_context(|| format!("{} is no JSON", path.display()))
        };
        let (benchmark, estimates) = (document("benchmark.json")?, document("estimates.json")?);
        let id = benchmark["full_id"].as_str().unwrap_or_default().replace(' ', "_");
        let mut parts = id.split('/');
        let (Some(bench), Some(model)) = (parts.next(), parts.next()) else { return Ok(()) };
        if model != self.scene {
            return Ok(());
        }
        let median = estimates["median"]["point_estimate"].as_f64().context("an estimate has a median")?;
        let count = |unit: &str| benchmark["throughput"][unit].as_f64();
        let rate = match count("Bytes") {
            Some(bytes) => json!({ "bytes_per_s": 1e9 * bytes / median }),
            None => json!({ "ns": median / count("Elements").unwrap_or(1.0) }),
        };
        let mut place = self.medians.entry(bench).or_insert_with(|| json!({}));
        for part in parts {
            place = &mut place[part];
        }
        *place = rate;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_one_model_are_read() {
        let inside = tempfile::tempdir().unwrap();
        let keep = |folder: &str, id: &str, throughput: Value, median: f64| {
            let folder = inside.path().join(folder).join("new");
            fs::create_dir_all(&folder).unwrap();
            let benchmark = json!({ "full_id": id, "throughput": throughput });
            fs::write(folder.join("benchmark.json"), benchmark.to_string()).unwrap();
            let estimates =
                json!({ "median": { "point_estimate": median }, "mean": { "point_estimate": 9.0 } });
            fs::write(folder.join("estimates.json"), estimates.to_string()).unwrap();
        };
        keep("a/b", "traversal/iso/at once/alone", json!({ "Elements": 4 }), 100.0);
        keep("c", "codec/iso/install", json!({ "Bytes": 1000 }), 500.0);
        keep("d", "codec/scan/install", json!({ "Bytes": 1000 }), 700.0);
        keep("e", "gray/iso/once", Value::Null, 8.0);
        let read = read(inside.path(), "iso").unwrap();
        assert_eq!(
            serde_json::to_value(&read).unwrap(),
            json!({
                "scene": "iso",
                "traversal": { "at_once": { "alone": { "ns": 25.0 } } },
                "codec": { "install": { "bytes_per_s": 2e9 } },
                "gray": { "once": { "ns": 8.0 } },
            })
        );
        assert!(super::read(inside.path(), "plant").is_err());
    }
}
