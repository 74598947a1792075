//! Long runs of enumerated cases: in parts that run side by side, each of which resumes where it was stopped.
//!
//! ```text
//! TREX_CASES=FILE  a line a case that has passed: campaign, case and outcome, with tabs between; it is not run again
//! TREX_PART=K/N    of all cases those whose number, counted from 0, is K where it is divided by N
//! ```
//!
//! Invariants: 1. without these variables every case is due; 2. a case is written once it has passed, never before;
//! 3. a count holds the cases of the runs before, too.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::Write;

const CASES_VARIABLE: &str = "TREX_CASES";
const PART_VARIABLE: &str = "TREX_PART";

/// The cases of one kind, with what became of those that have passed.
pub(crate) struct Campaign {
    name: &'static str,
    part: (usize, usize),
    /// Cases that were asked for.
    asked: usize,
    outcomes: BTreeMap<String, String>,
    log: Option<File>,
}

impl Campaign {
    /// The campaign of this name, as the environment has it.
    pub(crate) fn named(name: &'static str) -> Campaign {
        let part = std::env::var(PART_VARIABLE).map_or((0, 1), |part| parse_part(&part));
        let Some(path) = std::env::var_os(CASES_VARIABLE) else {
            return Campaign { name, part, asked: 0, outcomes: BTreeMap::new(), log: None };
        };
        let text = fs::read_to_string(&path).unwrap_or_default();
        let log = File::options().create(true).append(true).open(&path);
        let log = log.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Campaign { name, part, asked: 0, outcomes: parse_cases(name, &text), log: Some(log) }
    }

    /// True where the case of this name is to be run: it is of this part, and no run before has passed it.
    pub(crate) fn is_due(&mut self, case: &str) -> bool {
        let number = self.asked;
        self.asked += 1;
        number % self.part.1 == self.part.0 && !self.outcomes.contains_key(case)
    }

    /// Keeps what became of a case.
    pub(crate) fn passed(&mut self, case: &str, outcome: &str) {
        assert!(!case.contains(['\t', '\n']) && !outcome.contains(['\t', '\n']), "{case:?}: {outcome:?}");
        if let Some(log) = &mut self.log {
            // One write a line: other tests may append to the same file.
            log.write_all(format!("{}\t{case}\t{outcome}\n", self.name).as_bytes()).unwrap();
        }
        self.outcomes.insert(case.to_owned(), outcome.to_owned());
    }

    /// Cases with this outcome.
    pub(crate) fn count(&self, outcome: &str) -> usize {
        self.outcomes.values().filter(|known| *known == outcome).count()
    }
}

/// `1/4` as (1, 4).
fn parse_part(text: &str) -> (usize, usize) {
    let parts = text.split_once('/').and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)));
    let (part, of) = parts.unwrap_or_else(|| panic!("{PART_VARIABLE}={text}: not K/N"));
    assert!(part < of, "{PART_VARIABLE}={text}: parts are counted from 0");
    (part, of)
}

/// What became of the cases of a campaign. A line that was cut short when its run was stopped is no case.
fn parse_cases(name: &str, text: &str) -> BTreeMap<String, String> {
    let whole = text.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
    let fields = whole.filter_map(|line| {
        let mut fields = line.split('\t');
        let fields = (fields.next()?, fields.next()?, fields.next()?, fields.next());
        matches!(fields, (of, .., None) if of == name).then(|| (fields.1.to_owned(), fields.2.to_owned()))
    });
    fields.collect()
}

#[test]
fn a_campaign_resumes_after_the_cases_that_have_passed() {
    let outcomes = parse_cases("calls", "calls\ta 1\ttold\nwalls\tb\tdone\ncalls\tc\twhole\ncalls\td\tto");
    let mut campaign = Campaign { name: "calls", part: (0, 1), asked: 0, outcomes, log: None };
    assert!(!campaign.is_due("a 1") && campaign.is_due("b") && !campaign.is_due("c") && campaign.is_due("d"));
    campaign.passed("b", "told");
    assert!(!campaign.is_due("b"));
    assert_eq!((campaign.count("told"), campaign.count("whole")), (2, 1));
}

#[test]
fn parts_of_a_campaign_are_all_of_it() {
    let due = |part| {
        let mut campaign = Campaign { name: "calls", part, asked: 0, outcomes: BTreeMap::new(), log: None };
        (0..10).filter(|case| campaign.is_due(&case.to_string())).collect::<Vec<usize>>()
    };
    let mut all: Vec<usize> = (0..3).flat_map(|part| due((part, 3))).collect();
    all.sort_unstable();
    assert_eq!(all, (0..10).collect::<Vec<_>>());
    assert_eq!(parse_part("1/4"), (1, 4));
}
