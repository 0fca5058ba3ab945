//! Pairwise consistency maximisation: which closures between two robots can be right together (Mangelson, Dominic,
//! Eustice, Vasudevan, "Pairwise consistent measurement set maximization for robust multi-robot map merging", ICRA 2018).

/// Finds a large set of measurements that are all consistent with each other, in ascending order.
///
/// Greedy from each measurement in turn, as in the paper's fast variant (Pattabiraman et al. 2015): at most `count`³
/// comparisons. Of two sets of equal size the one of more `weight` wins.
pub(crate) fn largest_consistent_set(
    count: usize,
    weight: impl Fn(usize) -> f64,
    is_consistent: impl Fn(usize, usize) -> bool,
) -> Vec<usize> {
    let mut table = vec![false; count * count];
    for a in 0..count {
        for b in 0..a {
            let consistent = is_consistent(b, a);
            (table[a * count + b], table[b * count + a]) = (consistent, consistent);
        }
    }
    let degree: Vec<usize> =
        (0..count).map(|a| table[a * count..][..count].iter().filter(|c| **c).count()).collect();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| degree[*b].cmp(&degree[*a]).then(weight(*b).total_cmp(&weight(*a))).then(a.cmp(b)));
    let mut best: (usize, f64, Vec<usize>) = (0, 0.0, Vec::new());
    for first in &order {
        if degree[*first] + 1 < best.0 {
            continue;
        }
        let mut set = vec![*first];
        for next in &order {
            if next != first && set.iter().all(|member| table[next * count + member]) {
                set.push(*next);
            }
        }
        let sum: f64 = set.iter().map(|member| weight(*member)).sum();
        if set.len() > best.0 || (set.len() == best.0 && sum > best.1) {
            best = (set.len(), sum, set);
        }
    }
    best.2.sort_unstable();
    best.2
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_larger_of_two_groups_is_found() {
        let group = [0, 1, 0, 1, 1, 0, 1, 1];
        let found = largest_consistent_set(8, |_| 1.0, |a, b| group[a] == group[b]);
        assert_eq!(found, [1, 3, 4, 6, 7]);
        assert!(largest_consistent_set(0, |_| 1.0, |_, _| true).is_empty());
        assert_eq!(largest_consistent_set(3, |i| i as f64, |_, _| false), [2]);
    }

    proptest! {
        #[test]
        fn all_members_are_consistent_with_each_other(bits in prop::collection::vec(any::<bool>(), 144)) {
            let consistent = |a: usize, b: usize| bits[a.min(b) * 12 + a.max(b)];
            let found = largest_consistent_set(12, |_| 1.0, consistent);
            prop_assert!(!found.is_empty());
            for (k, a) in found.iter().enumerate() {
                for b in &found[..k] {
                    prop_assert!(consistent(*a, *b));
                }
            }
        }
    }
}
