//! A file of HDF5: MATLAB 7.3 or plain.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::exchange::{self, Options, options};
use volition::trial::Limits;

fuzz_target!(|data: &[u8]| {
    let Some((first, file)) = data.split_first() else { return };
    let paths = ["", "r:data.target,u:data.stick,y:data.cursor", "r:runs(2).r", "r:c{1},u:c{3},y:M(:,2)"];
    let columns = options::columns(paths[usize::from(*first) % paths.len()]).unwrap_or_default();
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 20 };
    let _ = exchange::read(file, &Options { columns, limits, ..Options::default() });
});
