//! The figures that a publication shows, made of a study.

use super::super::{Answer, ask};
use crate::store::Store;
use anyhow::{Context as _, bail};
use serde_json::Value;

/// What a publication shows of a study: each file with its address below the study.
struct Publication {
    name: &'static str,
    figures: &'static [(&'static str, &'static str)],
}

/// Chapter 3 of Zhang 2015 follows one group, chapter 5 compares two; both show the median subject's first and last
/// trial.
const PUBLICATIONS: [Publication; 2] = [
    Publication {
        name: "zhang2015_chapter_3",
        figures: &[
            ("error", "mean_abs_error"),
            ("distance_from_inverse", "norm_feedforward_minus_inverse"),
            ("feedback", "norm_feedback"),
            ("error_against_distance", "scatter"),
            ("controllers_first", "bode?trial=first"),
            ("controllers_last", "bode?trial=last"),
        ],
    },
    Publication {
        name: "zhang2015_chapter_5",
        figures: &[
            ("error", "mean_abs_error"),
            ("distance_from_inverse", "norm_feedforward_plant_minus_one"),
            ("distance_from_inverse_in_its_unit", "norm_feedforward_minus_inverse"),
            ("feedback", "norm_feedback"),
            ("share_explained", "variance_accounted_for"),
            ("smoothness", "control_log_dimensionless_jerk"),
            ("error_against_distance", "scatter"),
            ("controllers_first", "bode?trial=first"),
            ("controllers_last", "bode?trial=last"),
        ],
    },
];

/// A figure to be written.
pub(super) struct Asked {
    /// The name of its file, without an ending.
    pub file: String,
    /// Its address, with a query or without one.
    pub link: String,
}

/// The figures that a publication shows, of this study: learning curves, mean controllers, and the signals of each
/// group's median subject in its first and last trial.
///
/// # Errors
/// For an unknown name, and where the study cannot be read.
pub(super) async fn figures(store: &Store, study: &str, name: &str, estimator: &str) -> anyhow::Result<Vec<Asked>> {
    let Some(publication) = PUBLICATIONS.iter().find(|own| own.name == name) else {
        let known: Vec<&str> = PUBLICATIONS.iter().map(|own| own.name).collect();
        bail!("no figures are known like {name:?}; known are {}", known.join(" and "));
    };
    let own = publication.figures.iter().map(|(file, figure)| Asked {
        file: (*file).to_owned(),
        link: format!("/v1/studies/{study}/figures/{figure}"),
    });
    let mut all: Vec<Asked> = own.collect();
    let path =
        format!("/v1/studies/{study}/median-subjects?signals=false&estimator={}", super::super::encoded(estimator));
    let Answer::Body(body) = ask(store, &path).await? else { bail!("the median subjects of the study cannot be read") };
    let medians: Value = serde_json::from_slice(&body).context("the median subjects cannot be read")?;
    for group in medians["groups"].as_array().into_iter().flatten() {
        let code = group["median"]["code"].as_str().unwrap_or("nobody");
        let about = group["group"].as_str().unwrap_or("without_group");
        for trial in group["trials"].as_array().into_iter().flatten() {
            let Some(id) = trial["point"]["trial"].as_str() else { continue };
            let number = trial["point"]["number"].as_i64().unwrap_or_default();
            all.push(Asked {
                file: file_name(&format!("signals_{about}_{code}_trial_{number}")),
                link: format!("/v1/trials/{id}/figures/signals"),
            });
        }
    }
    Ok(all)
}

/// What a file may be called anywhere: other characters become underscores.
fn file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || "_-".contains(c) { c } else { '_' }).collect()
}
