//! The checks that turn a [`PoolSpec`] into a [`Recipe`].

use super::lists;
use super::recipe::{Ingredients, Recipe};
use super::roots::RootLists;
use super::spec::{
    Axis, Coefficients, Degrees, Grid, GridPool, ListedCoefficients, PoolName, PoolSpec, PoolSpecError, Range,
    RootGrid, RootsPool, Thin, TimeBaseName,
};

/// The most polynomials that one list may unfold to.
const LARGEST_LIST: u64 = 2_000_000;

/// The most numbers that one axis may hold.
const LARGEST_AXIS: u64 = 1_000_000;

fn wrong(field: &str, message: impl Into<String>) -> PoolSpecError {
    PoolSpecError { field: field.to_owned(), message: message.into(), too_large: false }
}

impl Axis {
    /// The values, in order and without repeats.
    fn values(&self, field: &str) -> Result<Vec<f64>, PoolSpecError> {
        let values = match self {
            Self::Values(values) => values.clone(),
            Self::Range(range) => range.values(field)?,
        };
        if let Some(i) = values.iter().position(|v| !v.is_finite()) {
            return Err(wrong(field, format!("value {i} is {}, and must be finite", values[i])));
        }
        let mut seen = std::collections::HashSet::new();
        // Adding zero makes −0 and 0 the same number.
        Ok(values.into_iter().map(|v| v + 0.0).filter(|v| seen.insert(v.to_bits())).collect())
    }
}

impl Range {
    fn values(&self, field: &str) -> Result<Vec<f64>, PoolSpecError> {
        let Self { from, to, .. } = *self;
        if !(from.is_finite() && to.is_finite() && from <= to) {
            return Err(wrong(field, format!("the range from {from} to {to} must be finite and not reversed")));
        }
        let (step, count) = match (self.step, self.count) {
            (Some(step), None) => {
                if !(step.is_finite() && step > 0.0) {
                    return Err(wrong(field, format!("the step {step} must be positive")));
                }
                // A step that reaches the end up to rounding reaches it.
                let steps = ((to - from) / step * (1.0 + 1e-12) + 1e-12).floor();
                (step, steps + 1.0)
            }
            (None, Some(count)) => {
                if count < 2 {
                    return Err(wrong(field, format!("a range of {count} values has no step; use at least 2")));
                }
                ((to - from) / (count - 1) as f64, count as f64)
            }
            _ => return Err(wrong(field, "a range has either `step` or `count`")),
        };
        if count > LARGEST_AXIS as f64 {
            return Err(PoolSpecError {
                too_large: true,
                ..wrong(field, format!("the range holds {count} values, and at most {LARGEST_AXIS} are taken"))
            });
        }
        let digits = 12 - from.abs().max(to.abs()).max(f64::MIN_POSITIVE).log10().ceil() as i32;
        // Formatting rounds in decimal, which scaling by a power of ten does not.
        let rounded = |v: f64| format!("{v:.*}", digits.clamp(0, 60) as usize).parse().unwrap_or(v);
        Ok((0..count as u64).map(|i| rounded(from + step * i as f64)).collect())
    }
}

impl Coefficients {
    pub(super) fn none() -> Self {
        Self::Axes(Vec::new())
    }

    /// Every combination, the first coefficient outermost; `leading` is put in front of each.
    fn unfold(&self, field: &str, leading: Option<f64>) -> Result<Vec<Vec<f64>>, PoolSpecError> {
        let too_many = |count: u128| PoolSpecError {
            too_large: true,
            ..wrong(field, format!("the grid holds {count} combinations, and at most {LARGEST_LIST} are taken"))
        };
        let rows = match self {
            Self::Axes(axes) => {
                let axes = axes
                    .iter()
                    .enumerate()
                    .map(|(i, axis)| axis.values(&format!("{field}/{i}")))
                    .collect::<Result<Vec<_>, _>>()?;
                let count = axes.iter().fold(1_u128, |n, axis| n.saturating_mul(axis.len() as u128));
                if count > u128::from(LARGEST_LIST) {
                    return Err(too_many(count));
                }
                let mut rows = vec![Vec::new()];
                for axis in axes {
                    rows = rows
                        .into_iter()
                        .flat_map(|row: Vec<f64>| {
                            axis.iter().map(move |v| [row.as_slice(), &[*v]].concat()).collect::<Vec<_>>()
                        })
                        .collect();
                }
                rows
            }
            Self::Listed(ListedCoefficients { listed }) => {
                if listed.len() as u64 > LARGEST_LIST {
                    return Err(too_many(listed.len() as u128));
                }
                let width = listed.first().map_or(0, Vec::len);
                let mut seen = std::collections::HashSet::new();
                let mut rows = Vec::new();
                for (i, row) in listed.iter().enumerate() {
                    if row.len() != width || row.iter().any(|c| !c.is_finite()) {
                        return Err(wrong(
                            &format!("{field}/listed/{i}"),
                            format!("the row {row:?} must hold {width} finite coefficients, as the first does"),
                        ));
                    }
                    let row: Vec<f64> = row.iter().map(|c| c + 0.0).collect();
                    if seen.insert(row.iter().map(|c| c.to_bits()).collect::<Vec<_>>()) {
                        rows.push(row);
                    }
                }
                rows
            }
        };
        if rows.is_empty() {
            return Err(wrong(field, "the grid is empty"));
        }
        Ok(rows.into_iter().map(|row| leading.into_iter().chain(row).collect()).collect())
    }
}

impl RootGrid {
    fn lists(&self, field: &str, largest: Option<f64>) -> Result<RootLists, PoolSpecError> {
        let at = |name: &str| format!("{field}/{name}");
        let keep = |v: &f64| largest.is_none_or(|limit| v.abs() <= limit);
        let mut lists = RootLists {
            real: self.real_rad_s.values(&at("real_rad_s"))?,
            natural_frequency: self.natural_frequency_rad_s.values(&at("natural_frequency_rad_s"))?,
            damping: self.damping_ratio.values(&at("damping_ratio"))?,
        };
        if let Some(w) = lists.natural_frequency.iter().find(|w| **w < 0.0) {
            return Err(wrong(&at("natural_frequency_rad_s"), format!("the natural frequency {w} is negative")));
        }
        if let Some(z) = lists.damping.iter().find(|z| z.abs() >= 1.0) {
            return Err(wrong(&at("damping_ratio"), format!("the damping ratio {z} is not inside (-1, 1)")));
        }
        lists.real.retain(keep);
        lists.natural_frequency.retain(keep);
        Ok(lists)
    }
}

fn thinned(list: &[f64], every: usize) -> Vec<f64> {
    list.iter().copied().step_by(every).collect()
}

impl RootLists {
    fn thin(&self, roots: usize, damping: usize) -> Self {
        Self {
            real: thinned(&self.real, roots),
            natural_frequency: thinned(&self.natural_frequency, roots),
            damping: thinned(&self.damping, damping),
        }
    }
}

fn pairs(lists: &RootLists, degree: usize, field: &str) -> Result<Ingredients, PoolSpecError> {
    if degree > 2 {
        return Err(wrong(
            field,
            format!(
                "lists of poles and zeros make polynomials of degree 0, 1 or 2, not {degree}; use a grid of \
                 coefficients"
            ),
        ));
    }
    let reals = lists.real.len() as u64;
    let count = match degree {
        2 => reals * (reals + 1) / 2 + (lists.natural_frequency.len() * lists.damping.len()) as u64,
        _ => reals,
    };
    if count > LARGEST_LIST {
        return Err(PoolSpecError {
            too_large: true,
            ..wrong(field, format!("the lists make {count} polynomials, and at most {LARGEST_LIST} are taken"))
        });
    }
    let pairs = lists.pairs(degree);
    if pairs.is_empty() {
        return Err(wrong(field, format!("the lists make no polynomial of degree {degree}")));
    }
    Ok(Ingredients::Roots(pairs))
}

/// Gains with both signs, each magnitude's positive first; and whether zero is among them.
fn signed(magnitudes: &[f64], both_signs: bool) -> (Vec<f64>, bool) {
    let gains = magnitudes
        .iter()
        .filter(|g| **g != 0.0)
        .flat_map(|g| if both_signs { vec![*g, -g] } else { vec![*g] })
        .collect();
    (gains, magnitudes.contains(&0.0))
}

impl PoolSpec {
    /// Checks the spec with the degrees that the request gives, and fills in the others.
    ///
    /// Defaults. Appendix B: feedforward numerator 4 and denominator 2, feedback numerator 1 and denominator 2.
    /// Appendix C: feedforward 2 and 2 (FIR), feedback 2 and 2. Own root grids: feedforward denominator 2 where poles
    /// are given, feedback numerator 1 where zeros are given, feedback denominator 2. Coefficient grids imply all but
    /// the feedforward numerator. The feedforward numerator has the degree of its denominator where nothing else is
    /// said.
    ///
    /// # Errors
    /// [`PoolSpecError`], which names the field.
    pub fn check(&self, degrees: Degrees) -> Result<Recipe, PoolSpecError> {
        match self {
            Self::Name(name) => named(*name, Thin::default(), degrees),
            Self::Thinned(pool) => named(pool.name, pool.thin, degrees),
            Self::Grid(pool) => grid(pool, degrees),
            Self::Roots(pool) => roots(pool, degrees),
        }
    }
}

fn margin_checked(margin: f64) -> Result<f64, PoolSpecError> {
    if margin.is_finite() && margin >= 0.0 {
        Ok(margin)
    } else {
        Err(wrong("pool/stability_margin", format!("the stability margin {margin} must be finite and not negative")))
    }
}

/// Degrees of an FIR (or, in continuous time, polynomial) feedforward: numerator and denominator.
fn without_denominator(sampled: bool, degrees: Degrees) -> Result<(usize, usize), PoolSpecError> {
    let (numerator, denominator) = (degrees.feedforward_numerator, degrees.feedforward_denominator);
    if sampled {
        let order = denominator.or(numerator).unwrap_or(2);
        return Ok((numerator.unwrap_or(order), order));
    }
    match denominator {
        None | Some(0) => Ok((numerator.unwrap_or(0), 0)),
        Some(d) => Err(wrong(
            "feedforward_denominator_degree",
            format!("the pool gives no feedforward denominators, but the degree {d} is asked for"),
        )),
    }
}

fn named(name: PoolName, thin: Thin, degrees: Degrees) -> Result<Recipe, PoolSpecError> {
    let feedforward_poles = thin.feedforward_poles.unwrap_or(thin.poles);
    let steps = [
        ("poles", thin.poles),
        ("feedforward_poles", feedforward_poles),
        ("zeros", thin.zeros),
        ("damping", thin.damping),
        ("gains", thin.gains),
    ];
    if let Some((field, _)) = steps.iter().find(|(_, every)| *every == 0) {
        return Err(wrong(&format!("pool/thin/{field}"), "every 0-th element cannot be kept; use 1 to keep all"));
    }
    let feedback_denominator = degrees.feedback_denominator.unwrap_or(2);
    let nonzero: Vec<f64> = lists::peak_gains().into_iter().filter(|g| *g != 0.0).collect();
    let (gains, _) = signed(&thinned(&nonzero, thin.gains), true);
    let pi = std::f64::consts::PI;
    let recipe = match name {
        PoolName::Zhang2015AppendixB => {
            let lists = lists::appendix_b();
            let denominator = degrees.feedforward_denominator.unwrap_or(2);
            Recipe {
                sampled: Some(false),
                feedforward: pairs(
                    &lists.thin(feedforward_poles, thin.damping),
                    denominator,
                    "feedforward_denominator_degree",
                )?,
                feedforward_numerator_degree: degrees.feedforward_numerator.unwrap_or(4),
                feedforward_denominator_degree: denominator,
                feedback_numerators: pairs(
                    &lists.thin(thin.zeros, thin.damping),
                    degrees.feedback_numerator.unwrap_or(1),
                    "feedback_numerator_degree",
                )?,
                feedback_denominators: pairs(
                    &lists.thin(thin.poles, thin.damping),
                    feedback_denominator,
                    "feedback_denominator_degree",
                )?,
                gains,
                zero_gain: true,
                band_rad_s: Some([0.2 * pi, 0.8 * pi]),
                margin: 0.1,
                held: None,
            }
        }
        PoolName::Zhang2015AppendixC => {
            let (numerator, denominator) = without_denominator(true, degrees)?;
            Recipe {
                sampled: Some(true),
                feedforward: Ingredients::Power(denominator),
                feedforward_numerator_degree: numerator,
                feedforward_denominator_degree: denominator,
                feedback_numerators: pairs(
                    &lists::appendix_c_zeros().thin(thin.zeros, thin.damping),
                    degrees.feedback_numerator.unwrap_or(2),
                    "feedback_numerator_degree",
                )?,
                feedback_denominators: pairs(
                    &lists::appendix_c_poles().thin(thin.poles, thin.damping),
                    feedback_denominator,
                    "feedback_denominator_degree",
                )?,
                gains,
                zero_gain: true,
                band_rad_s: Some([0.0, pi]),
                margin: 0.1,
                held: None,
            }
        }
    };
    recipe.checked()
}

fn agree(field: &str, asked: Option<usize>, implied: usize) -> Result<usize, PoolSpecError> {
    match asked {
        Some(degree) if degree != implied => {
            Err(wrong(field, format!("the grid implies degree {implied}, but {degree} is asked for")))
        }
        _ => Ok(implied),
    }
}

fn grid(pool: &GridPool, degrees: Degrees) -> Result<Recipe, PoolSpecError> {
    let Grid { feedforward_denominator, feedback_numerator, feedback_denominator } = &pool.grid;
    let sampled = pool.time.map(|t| t == TimeBaseName::Sampled);
    let numerators = feedback_numerator.unfold("pool/grid/feedback_numerator", None)?;
    let denominators = feedback_denominator.unfold("pool/grid/feedback_denominator", Some(1.0))?;
    if numerators[0].is_empty() {
        return Err(wrong("pool/grid/feedback_numerator", "a numerator needs at least one coefficient"));
    }
    agree("feedback_numerator_degree", degrees.feedback_numerator, numerators[0].len() - 1)?;
    agree("feedback_denominator_degree", degrees.feedback_denominator, denominators[0].len() - 1)?;
    let (feedforward, numerator, denominator) = match feedforward_denominator {
        Some(coefficients) => {
            let rows = coefficients.unfold("pool/grid/feedforward_denominator", Some(1.0))?;
            let implied = rows[0].len() - 1;
            agree("feedforward_denominator_degree", degrees.feedforward_denominator, implied)?;
            (Ingredients::Coefficients(rows), degrees.feedforward_numerator.unwrap_or(implied), implied)
        }
        None => {
            // Whether this is an FIR filter or a polynomial in s shows when the plant is known, if the spec does not
            // say.
            let (numerator, denominator) = without_denominator(sampled != Some(false), degrees)?;
            (Ingredients::Power(denominator), numerator, denominator)
        }
    };
    Recipe {
        sampled,
        feedforward,
        feedforward_numerator_degree: numerator,
        feedforward_denominator_degree: denominator,
        feedback_numerators: Ingredients::Coefficients(numerators),
        feedback_denominators: Ingredients::Coefficients(denominators),
        gains: vec![1.0],
        zero_gain: false,
        band_rad_s: None,
        margin: margin_checked(pool.stability_margin)?,
        held: None,
    }
    .checked()
}

fn roots(pool: &RootsPool, degrees: Degrees) -> Result<Recipe, PoolSpecError> {
    let grids = &pool.roots;
    let sampled = pool.time.map(|t| t == TimeBaseName::Sampled);
    let largest = grids.largest_root_rad_s;
    if let Some(limit) = largest.filter(|limit| !(limit.is_finite() && *limit > 0.0)) {
        return Err(wrong("pool/roots/largest_root_rad_s", format!("the limit {limit} must be finite and positive")));
    }
    let [low, high] = grids.band_rad_s;
    if !(low >= 0.0 && low < high && high.is_finite()) {
        return Err(wrong("pool/roots/band_rad_s", format!("the band [{low}, {high}] must satisfy 0 <= low < high")));
    }
    let magnitudes = grids.peak_gains.values("pool/roots/peak_gains")?;
    if let Some(gain) = magnitudes.iter().find(|g| **g < 0.0) {
        return Err(wrong(
            "pool/roots/peak_gains",
            format!("the peak gain {gain} is negative; signs come from `both_signs`"),
        ));
    }
    if magnitudes.is_empty() {
        return Err(wrong("pool/roots/peak_gains", "no gain is listed"));
    }
    let zeros = grids.feedback_zeros.lists("pool/roots/feedback_zeros", largest)?;
    let has_zeros = grids.feedback_zeros != RootGrid::default();
    let (feedforward, numerator, denominator) = match &grids.feedforward_poles {
        Some(poles) => {
            let field = "pool/roots/feedforward_poles";
            let degree = degrees.feedforward_denominator.unwrap_or(2);
            let ingredients = pairs(&poles.lists(field, largest)?, degree, field)?;
            (ingredients, degrees.feedforward_numerator.unwrap_or(degree), degree)
        }
        None => {
            let (numerator, denominator) = without_denominator(sampled != Some(false), degrees)?;
            (Ingredients::Power(denominator), numerator, denominator)
        }
    };
    let (gains, zero_gain) = signed(&magnitudes, grids.both_signs);
    Recipe {
        sampled,
        feedforward,
        feedforward_numerator_degree: numerator,
        feedforward_denominator_degree: denominator,
        feedback_numerators: pairs(
            &zeros,
            degrees.feedback_numerator.unwrap_or(usize::from(has_zeros)),
            "pool/roots/feedback_zeros",
        )?,
        feedback_denominators: pairs(
            &grids.feedback_poles.lists("pool/roots/feedback_poles", largest)?,
            degrees.feedback_denominator.unwrap_or(2),
            "pool/roots/feedback_poles",
        )?,
        gains,
        zero_gain,
        band_rad_s: Some([low, high]),
        margin: margin_checked(pool.stability_margin)?,
        held: None,
    }
    .checked()
}

pub(super) fn refuse(field: &str, message: String) -> PoolSpecError {
    wrong(field, message)
}

#[cfg(test)]
mod tests;
