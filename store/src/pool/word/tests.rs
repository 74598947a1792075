//! The word against the plain struct that it packs, and its bounds.

use super::*;
use proptest::prelude::*;

#[derive(Clone, Copy, Debug)]
enum Step {
    Enqueue,
    Unqueue,
    BeginRead(u32, bool),
    Install,
    Abandon,
    Damage,
    Ask,
    Pin,
    LookAhead,
    Unpin,
    Cool,
    TakeCold,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        2 => Just(Step::Enqueue),
        1 => Just(Step::Unqueue),
        3 => (0..FRAMES_MAX as u32, any::<bool>()).prop_map(|(frame, ahead)| Step::BeginRead(frame, ahead)),
        3 => Just(Step::Install),
        1 => Just(Step::Abandon),
        1 => Just(Step::Damage),
        1 => Just(Step::Ask),
        4 => Just(Step::Pin),
        2 => Just(Step::LookAhead),
        5 => Just(Step::Unpin),
        5 => Just(Step::Cool),
        3 => Just(Step::TakeCold),
    ]
}

/// The same page as a plain struct; `None` where the caller must not take the step.
fn model(page: View, step: Step) -> Option<View> {
    use PageState::*;
    let page = match (step, page.state) {
        (Step::Enqueue, Absent) => View { state: Queued, ..page },
        (Step::Unqueue, Queued) => View { state: Absent, ..page },
        (Step::BeginRead(frame, ahead), Queued) => View { state: Reading, frame, ahead, score: 0, ..page },
        (Step::Install, Reading) => View { state: Resident, score: if page.ahead { 0 } else { 2 }, ..page },
        (Step::Ask, Reading) => View { ahead: false, ..page },
        (Step::Abandon, Reading) => View { state: Absent, frame: 0, ahead: false, ..page },
        (Step::Damage, Reading) => View { state: Damaged, frame: 0, ahead: false, ..page },
        (Step::Pin, Resident) => {
            View { pins: page.pins + 1, score: 3.min(page.score + 1), ahead: false, ..page }
        }
        (Step::LookAhead, Resident) => View { pins: page.pins + 1, score: 3.min(page.score + 1), ..page },
        (Step::Unpin, Resident) if page.pins > 0 => View { pins: page.pins - 1, ..page },
        (Step::Cool, Resident) if page.pins == 0 && page.score > 0 => View { score: page.score - 1, ..page },
        (Step::Cool | Step::TakeCold, Resident) if page.pins == 0 && page.score == 0 => {
            View { state: Absent, frame: 0, ahead: false, generation: page.generation + 1, ..page }
        }
        // Steps that anybody may try at any time and that change nothing.
        (Step::Enqueue | Step::Ask | Step::Pin | Step::LookAhead | Step::Cool | Step::TakeCold, _) => page,
        _ => return None,
    };
    Some(page)
}

proptest! {
    #[test]
    fn the_word_is_the_plain_struct(steps in prop::collection::vec(step(), 0..200)) {
        let word = Word::absent();
        let mut page = word.view();
        for step in steps {
            let Some(after) = model(page, step) else { continue };
            match step {
                Step::Enqueue => prop_assert_eq!(word.enqueue().is_ok(), after != page),
                Step::Unqueue => word.unqueue(),
                Step::BeginRead(frame, ahead) => word.begin_read(frame, ahead),
                Step::Install => word.install(),
                Step::Abandon => word.abandon(),
                Step::Damage => word.damage(),
                Step::Ask => prop_assert_eq!(word.ask(), after != page),
                Step::Pin | Step::LookAhead => {
                    let is_resident = page.state == PageState::Resident;
                    prop_assert_eq!(word.try_pin(matches!(step, Step::LookAhead)), is_resident.then_some(page));
                }
                Step::Unpin => prop_assert_eq!(word.unpin(), after.pins == 0),
                Step::Cool | Step::TakeCold => {
                    let outcome = if matches!(step, Step::Cool) { word.cool() } else { word.take_cold() };
                    match outcome {
                        CoolOutcome::Evicted | CoolOutcome::Wasted => {
                            prop_assert_eq!(outcome == CoolOutcome::Wasted, page.ahead);
                            prop_assert!(page.pins == 0 && after.state == PageState::Absent);
                        }
                        CoolOutcome::Warm => {
                            prop_assert_eq!(after.score + u64::from(matches!(step, Step::Cool)), page.score);
                        }
                        CoolOutcome::Busy => prop_assert_eq!(after, page),
                    }
                }
            }
            page = after;
            prop_assert_eq!(word.view(), page);
        }
    }
}

#[test]
fn pins_stop_at_the_maximum() {
    let word = Word::absent();
    word.enqueue().unwrap();
    word.begin_read(3, false);
    word.install();
    for _ in 0..PINS_MAX {
        word.try_pin(false).unwrap();
    }
    assert_eq!(word.try_pin(false), None);
    assert_eq!(word.view().frame, 3);
}

#[test]
fn generations_wrap_past_zero() {
    assert_eq!((next_generation(0), next_generation(GENERATION_MASK)), (1, 1));
}

#[test]
#[should_panic(expected = "unpin of")]
fn an_unpin_too_many_is_a_bug() {
    Word::absent().unpin();
}
