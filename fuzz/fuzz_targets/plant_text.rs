//! A plant as text in a table: what is read can be checked, and reads as a plant when it is written.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::app::import::plant_text;
use volition::control::Model;

fuzz_target!(|text: &str| {
    let Ok(model) = plant_text::parse(text) else { return };
    let _ = model.check();
    if let Model::TransferFunction(model) = &model {
        // What is written may pass the length or the power that a reader takes, and nothing else may be wrong with it.
        let written = plant_text::write(model);
        let again = plant_text::parse(&written);
        let at_limits = written.chars().count() > 300 || written.contains('^');
        assert!(again.is_ok() || at_limits, "{text:?} → {written:?}: {again:?}");
    }
});
