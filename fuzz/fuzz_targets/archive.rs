//! An archive: of NumPy, of Excel, or of a folder.
#![no_main]

use libfuzzer_sys::fuzz_target;
use volition::exchange::{self, Options, archive, options};
use volition::trial::Limits;

fuzz_target!(|data: &[u8]| {
    let Some((first, file)) = data.split_first() else { return };
    let mapping = if first & 1 == 0 { "" } else { "t:1,r:2,u:3,y:4" };
    let limits = Limits { max_rows: 1000, max_bytes: 1 << 20 };
    let columns = options::columns(mapping).unwrap_or_default();
    let _ = exchange::read(file, &Options { columns, limits, ..Options::default() });
    if archive::is_folder(file) {
        let _ = archive::folder(file, 1 << 20);
    }
});
