//! The word against the plain struct that it packs, and its bounds.

use super::*;
use proptest::prelude::*;

#[derive(Clone, Copy, Debug)]
enum Step {
    Enqueue,
    Unqueue,
    BeginRead(u32, Class),
    Promote(Class),
    Install,
    Damage,
    Pin,
    Unpin,
    Cool,
}

fn class() -> impl Strategy<Value = Class> {
    (0..4_u64).prop_map(Class::from_bits)
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        2 => Just(Step::Enqueue),
        1 => Just(Step::Unqueue),
        3 => (0..FRAMES_MAX as u32, class()).prop_map(|(frame, class)| Step::BeginRead(frame, class)),
        1 => class().prop_map(Step::Promote),
        3 => Just(Step::Install),
        1 => Just(Step::Damage),
        6 => Just(Step::Pin),
        5 => Just(Step::Unpin),
        5 => Just(Step::Cool),
    ]
}

/// The same page as a plain struct; `None` where the caller must not take the step.
fn model(page: View, step: Step) -> Option<View> {
    use PageState::*;
    let page = match (step, page.state) {
        (Step::Enqueue, Absent) => View { state: Queued, ..page },
        (Step::Unqueue, Queued) => View { state: Absent, ..page },
        (Step::BeginRead(frame, class), Queued) => View { state: Reading, frame, class, score: 0, ..page },
        (Step::Promote(class), Reading) => {
            let low = |class| matches!(class, Class::Prefetch | Class::Background);
            let class = if low(page.class) && !low(class) { class } else { page.class };
            View { class, ..page }
        }
        (Step::Install, Reading) => {
            let demand = matches!(page.class, Class::Urgent | Class::Normal);
            View { state: Resident, score: if demand { 2 } else { 0 }, ..page }
        }
        (Step::Damage, Reading) => View { state: Damaged, frame: 0, ..page },
        (Step::Pin, Resident) => {
            let class = if page.class == Class::Prefetch { Class::Normal } else { page.class };
            View { pins: page.pins + 1, score: 3.min(page.score + 1), class, ..page }
        }
        (Step::Unpin, Resident) if page.pins > 0 => View { pins: page.pins - 1, ..page },
        (Step::Cool, Resident) if page.pins == 0 && page.score > 0 => View { score: page.score - 1, ..page },
        (Step::Cool, Resident) if page.pins == 0 => {
            View { state: Absent, frame: 0, class: Class::Urgent, generation: page.generation + 1, ..page }
        }
        // Steps that anybody may try at any time and that change nothing.
        (Step::Enqueue | Step::Promote(_) | Step::Pin | Step::Cool, _) => page,
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
                Step::BeginRead(frame, class) => word.begin_read(frame, class),
                Step::Promote(class) => prop_assert_eq!(word.promote(class), after != page),
                Step::Install => word.install(),
                Step::Damage => word.damage(),
                Step::Pin => {
                    let pinned = word.try_pin();
                    prop_assert_eq!(pinned.is_some(), page.state == PageState::Resident);
                    if let Some(pinned) = pinned {
                        let first_use = page.class == Class::Prefetch;
                        prop_assert_eq!(pinned, Pinned { frame: page.frame, first_use });
                    }
                }
                Step::Unpin => prop_assert_eq!(word.unpin(), after.pins == 0),
                Step::Cool => match word.cool() {
                    Cooled::Evicted { wasted } => {
                        prop_assert!(page.pins == 0 && after.state == PageState::Absent);
                        prop_assert_eq!(wasted, page.class == Class::Prefetch);
                    }
                    Cooled::Warm => prop_assert_eq!(after.score + 1, page.score),
                    Cooled::Busy => prop_assert_eq!(after, page),
                },
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
    word.begin_read(3, Class::Normal);
    word.install();
    for _ in 0..PINS_MAX {
        word.try_pin().unwrap();
    }
    assert_eq!(word.try_pin(), None);
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
