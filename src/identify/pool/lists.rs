//! Lists of numbers: written out, or as a range; and the lists of Zhang 2015, appendices B and C.

use super::roots::RootLists;

/// `first/unit, (first + step)/unit, …`, `count` of them, each the double nearest to its decimal.
pub(super) fn decimals(first: i64, step: i64, count: i64, unit: f64) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| (first + step * i) as f64 / unit)
}

/// The damping ratios of both appendices: from −0.9 to 0.9, denser near zero.
fn damping() -> Vec<f64> {
    decimals(-90, 10, 5, 100.0)
        .chain(decimals(-45, 5, 6, 100.0))
        .chain(decimals(-18, 2, 19, 100.0))
        .chain(decimals(20, 5, 6, 100.0))
        .chain(decimals(50, 10, 5, 100.0))
        .collect()
}

/// The peak gains of both appendices, K: 0, 0.1, …, 0.9, then powers of 1.1 up to 28.1, then 30.5.
pub(super) fn peak_gains() -> Vec<f64> {
    decimals(0, 1, 10, 10.0)
        .chain(std::iter::successors(Some(1.0), |gain| Some(gain * 1.1)).take(36))
        .chain([30.5])
        .collect()
}

/// Poles and zeros of appendix B, up to 25 rad/s.
pub(super) fn appendix_b() -> RootLists {
    RootLists {
        real: decimals(-250, 5, 45, 10.0).chain(decimals(-26, 1, 53, 10.0)).chain(decimals(30, 5, 45, 10.0)).collect(),
        natural_frequency: decimals(0, 5, 53, 100.0)
            .chain(decimals(270, 10, 64, 100.0))
            .chain(decimals(950, 50, 32, 100.0))
            .collect(),
        damping: damping(),
    }
}

fn appendix_c_natural_frequency() -> Vec<f64> {
    decimals(5, 5, 64, 100.0).chain(decimals(330, 10, 88, 100.0)).chain(decimals(1250, 50, 19, 100.0)).collect()
}

/// Poles of appendix C, up to 31.5 rad/s, none at zero.
pub(super) fn appendix_c_poles() -> RootLists {
    RootLists {
        real: decimals(-315, 5, 57, 10.0)
            .chain(decimals(-32, 1, 32, 10.0))
            .chain(decimals(1, 1, 32, 10.0))
            .chain(decimals(35, 5, 57, 10.0))
            .collect(),
        natural_frequency: appendix_c_natural_frequency(),
        damping: damping(),
    }
}

/// Zeros of appendix C: as its poles, and zero.
pub(super) fn appendix_c_zeros() -> RootLists {
    RootLists {
        real: decimals(-315, 5, 57, 10.0).chain(decimals(-32, 1, 65, 10.0)).chain(decimals(35, 5, 57, 10.0)).collect(),
        natural_frequency: appendix_c_natural_frequency(),
        damping: damping(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lists_have_the_lengths_and_ends_of_the_appendices() {
        let b = appendix_b();
        assert_eq!((b.real.len(), b.natural_frequency.len(), b.damping.len()), (143, 149, 41));
        assert_eq!((b.real[0], b.real[44], b.real[45], b.real[97], b.real[142]), (-25.0, -3.0, -2.6, 2.6, 25.0));
        assert_eq!(b.natural_frequency[148], 25.0);
        assert_eq!(b.pairs(2).len(), 16_364);
        assert_eq!(appendix_c_poles().pairs(2).len(), 22_942);
        assert_eq!(appendix_c_zeros().pairs(2).len(), 23_121);
        assert_eq!(peak_gains().len(), 47);
        for lists in [b, appendix_c_poles(), appendix_c_zeros()] {
            assert!(lists.real.is_sorted_by(|a, b| a < b));
            assert!(lists.natural_frequency.is_sorted_by(|a, b| a < b));
            assert!(lists.damping.is_sorted_by(|a, b| a < b));
        }
    }
}
