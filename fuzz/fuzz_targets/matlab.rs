//! A file of MATLAB, of either level.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::exchange::matlab::{self, Level};
use volition::exchange::{self, Options, options};
use volition::trial::Limits;

fuzz_target!(|data: &[u8]| {
    let Some((first, file)) = data.split_first() else { return };
    let level = if first & 1 == 0 { Level::Five } else { Level::Four };
    let _ = matlab::read(file, level, 1 << 20);
    let paths = ["", "r:data.target,u:data.stick,y:data.cursor", "r:runs(2).signals.r", "r:c{1},u:c{3}.u,y:M(:,2)"];
    let mapping = options::columns(paths[usize::from(first >> 1) % paths.len()]).unwrap_or_default();
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 20 };
    let _ = exchange::read(file, &Options { columns: mapping, limits, ..Options::default() });
});
