//! The figures that a publication shows, made of a study or of an analysis.

use super::super::{Answer, ask};
use super::Source;
use crate::store::Store;
use anyhow::{Context as _, bail};
use serde_json::Value;

/// What a publication shows: of a study, or of an analysis of a kind.
struct Publication {
    name: &'static str,
    of: Of,
}

/// What it is made of.
enum Of {
    /// A study: each file with its address below the study, files of each group's median subject, and which of that
    /// subject's trials are shown as signals.
    Study { figures: &'static [Drawn], of_median: &'static [Drawn], signals: &'static str },
    /// An analysis: each file with the name of the figure; those that the analysis does not have are left out.
    Analysis(&'static [Drawn]),
}

/// A file, and what is drawn in it.
type Drawn = (&'static str, &'static str);

/// Every figure of these that shows data; drawings of apparatus and block diagrams are none. Chapter 3 of Zhang 2015
/// follows one group, chapter 5 compares three.
const PUBLICATIONS: [Publication; 6] = [
    Publication {
        name: "zhang2015_chapter_3",
        of: Of::Study {
            figures: &[
                ("figure_3_2b_error", "mean_abs_error"),
                ("figure_3_6a_feedback", "norm_feedback"),
                ("figure_3_6a_distance_from_inverse", "norm_feedforward_minus_inverse"),
                ("figure_3_6b_error_against_distance", "scatter_inverse"),
                ("figure_3_6c_controllers_last", "bode?trial=last"),
                ("controllers_first", "bode?trial=first"),
            ],
            of_median: &[("figure_3_5_controllers", "bode_practice")],
            signals: "first,last",
        },
    },
    Publication {
        name: "zhang2015_chapter_5",
        of: Of::Study {
            figures: &[
                ("figure_5_3_plants", "plants"),
                ("figure_5_4_plant_zero", "plant_zero"),
                ("figure_5_5_plant_steps", "plant_steps"),
                ("figure_5_7_error", "mean_abs_error"),
                ("figure_5_8_divergent", "divergent"),
                ("figure_5_14_distance_from_inverse", "norm_feedforward_plant_minus_one"),
                ("figure_5_14_feedback", "norm_feedback"),
                ("figure_5_15_error_against_distance", "scatter"),
                ("figure_5_16_controllers_last", "bode?trial=last"),
                ("figure_5_17_last_trial", "last_trial"),
                ("figure_5_18_without_extremes", "bode_trimmed"),
                ("controllers_first", "bode?trial=first"),
                ("share_explained", "variance_accounted_for"),
                ("figure_5_19_smoothness", "control_log_dimensionless_jerk"),
            ],
            of_median: &[("figure_5_13_controllers", "bode_practice")],
            signals: "first,10,20,30,40,last",
        },
    },
    Publication {
        name: "qiu2021",
        of: Of::Analysis(&[
            ("figure_2a_3_spectrum", "spectrum"),
            ("figure_2b_3_flatness", "flatness"),
            ("signal", "signal"),
            ("autocorrelation", "autocorrelation"),
            ("figure_5_compensator", "compensator"),
        ]),
    },
    Publication {
        name: "priess2015_chapter_3",
        of: Of::Analysis(&[("figure_3_1_descent", "descent"), ("cost", "cost")]),
    },
    Publication {
        name: "priess2015_chapter_4",
        of: Of::Analysis(&[("figure_4_1_descent", "descent"), ("cost", "cost")]),
    },
    Publication {
        name: "priess2015_chapter_5",
        of: Of::Analysis(&[
            ("figure_5_6_input", "input"),
            ("figure_5_6_improvement", "improvement"),
            ("figure_5_7_outputs", "outputs"),
            ("figure_5_7_autocorrelation", "autocorrelation"),
            ("table_5_5_deviations", "deviations"),
        ]),
    },
];

/// A figure to be written.
pub(super) struct Asked {
    /// The name of its file, without an ending.
    pub file: String,
    /// Its address, with a query or without one.
    pub link: String,
}

/// The names of the figures that a thing lists.
async fn listed(store: &Store, address: &str) -> anyhow::Result<Vec<String>> {
    let Answer::Body(list) = ask(store, &format!("{address}/figures")).await? else {
        bail!("the figures of {address} cannot be listed");
    };
    let list: Value = serde_json::from_slice(&list).context("the list of figures cannot be read")?;
    let names = list["figures"].as_array().into_iter().flatten();
    Ok(names.filter_map(|figure| figure["name"].as_str().map(str::to_owned)).collect())
}

/// The figures that a publication shows, of this study (learning curves, controllers, plants, and the signals and
/// controllers of each group's median subject) or of this analysis.
///
/// # Errors
/// For an unknown name, for one of another sort of thing, and where that cannot be read.
pub(super) async fn figures(store: &Store, source: &Source, name: &str, estimator: &str) -> anyhow::Result<Vec<Asked>> {
    let Some(publication) = PUBLICATIONS.iter().find(|own| own.name == name) else {
        let known: Vec<&str> = PUBLICATIONS.iter().map(|own| own.name).collect();
        bail!("no figures are known like {name:?}; known are {}", known.join(", "));
    };
    let address = source.address();
    let has = listed(store, &address).await?;
    let own = |figures: &[Drawn]| -> Vec<Asked> {
        let figure_of = |link: &str| link.split('?').next().unwrap_or_default().to_owned();
        let there = figures.iter().filter(|(_, link)| has.contains(&figure_of(link)));
        there
            .map(|(file, link)| Asked { file: (*file).to_owned(), link: format!("{address}/figures/{link}") })
            .collect()
    };
    match (&publication.of, source) {
        (Of::Study { figures, of_median, signals }, Source::Study(study)) => {
            let mut all = own(figures);
            all.extend(medians(store, study, of_median, signals, estimator).await?);
            Ok(all)
        }
        (Of::Analysis(figures), Source::Analysis(_)) => {
            let all = own(figures);
            if all.is_empty() {
                bail!("the analysis has none of the figures of {name}; those that it has are {}", has.join(", "));
            }
            Ok(all)
        }
        (Of::Study { .. }, Source::Analysis(_)) => bail!("{name} shows a study, and this is an analysis"),
        (Of::Analysis(_), Source::Study(_)) => {
            bail!("{name} shows an analysis, and this is a study: give the id of an analysis")
        }
    }
}

/// What is shown of each group's median subject.
async fn medians(
    store: &Store,
    study: &str,
    figures: &[Drawn],
    trials: &str,
    estimator: &str,
) -> anyhow::Result<Vec<Asked>> {
    let estimator = super::super::encoded(estimator);
    let path = format!("/v1/studies/{study}/median-subjects?signals=false&trials={trials}&estimator={estimator}");
    let Answer::Body(body) = ask(store, &path).await? else { bail!("the median subjects of the study cannot be read") };
    let medians: Value = serde_json::from_slice(&body).context("the median subjects cannot be read")?;
    let mut all: Vec<Asked> = Vec::new();
    for group in medians["groups"].as_array().into_iter().flatten() {
        let code = group["median"]["code"].as_str().unwrap_or("nobody");
        let about = group["group"].as_str().unwrap_or("without_group");
        if let Some(subject) = group["median"]["subject"].as_str() {
            all.extend(figures.iter().map(|(file, figure)| Asked {
                file: file_name(&format!("{file}_{about}_{code}")),
                link: format!("/v1/studies/{study}/figures/{figure}?subject={subject}"),
            }));
        }
        for trial in group["trials"].as_array().into_iter().flatten() {
            let Some(id) = trial["point"]["trial"].as_str() else { continue };
            let number = trial["point"]["number"].as_i64().unwrap_or_default();
            let file = file_name(&format!("signals_{about}_{code}_trial_{number}"));
            // The first trial may be one of those that are named too.
            if all.iter().all(|own| own.file != file) {
                all.push(Asked { file, link: format!("/v1/trials/{id}/figures/signals") });
            }
        }
    }
    Ok(all)
}

/// What a file may be called anywhere: other characters become underscores.
fn file_name(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || "_-".contains(c) { c } else { '_' }).collect()
}
