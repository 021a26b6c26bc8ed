//! Fewer of a list where all of them are too many.

/// 2⁶⁴ by the golden ratio: whole multiples of it, wrapped, fill their range more evenly than those of any
/// other number (Weyl 1916), and in step with no period.
const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// Exactly `most` of the list in their order, or all where there are no more. They come evenly from all of it,
/// but in step with nothing in it: every fifth contact of a hand with five fingers would be the thumb's.
///
/// ```
/// let list: Vec<usize> = (0..300).collect();
/// let few = tactile_host::thin::evenly(&list, 60);
/// assert_eq!(few.len(), 60);
/// // Of every finger about as many.
/// let of = |finger| few.iter().filter(|i| *i % 5 == finger).count();
/// assert!((0..5).all(|finger| (9..=15).contains(&of(finger))));
/// ```
pub fn evenly<T: Copy>(list: &[T], most: usize) -> Vec<T> {
    if list.len() <= most {
        return list.to_vec();
    }
    let rank = |i: &usize| (*i as u64).wrapping_mul(GOLDEN);
    let mut kept: Vec<usize> = (0..list.len()).collect();
    kept.sort_unstable_by_key(rank);
    kept.truncate(most);
    kept.sort_unstable();
    kept.into_iter().map(|i| list[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Of every part of the list as many as its share, give or take three, and of every finger seven.
        #[test]
        fn every_part_has_its_share(
            length in 1usize..2000, most in 0usize..300, fingers in 1usize..9, cut in 0.0..1.0f64,
        ) {
            let list: Vec<usize> = (0..length).collect();
            let few = evenly(&list, most);
            prop_assert_eq!(few.len(), most.min(length));
            prop_assert!(few.is_sorted());
            let share = few.len() as f64 / length as f64;
            let end = (cut * length as f64) as usize;
            let before = few.iter().filter(|i| **i < end).count() as f64;
            prop_assert!((before - share * end as f64).abs() < 3.0);
            for finger in 0..fingers {
                let own = few.iter().filter(|i| *i % fingers == finger).count() as f64;
                let all = (0..length).filter(|i| i % fingers == finger).count() as f64;
                prop_assert!((own - share * all).abs() < 7.0, "{own} of {all}, share {share}");
            }
        }
    }
}
