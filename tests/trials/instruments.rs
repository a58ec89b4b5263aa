//! Recordings as programs of laboratories write them: what each is taken for, or why it is refused and what to do.
//!
//! `tests/exchange/instruments.py` writes them, and `tests/golden/instruments.txt` says in a line what is made of each.
//! Where one is read, its signals are those that were written into it, bit for bit.

use crate::layouts::{line, signals};
use std::fmt::Write as _;
use std::path::Path;
use volition::exchange::{self, Options, Resampling, TimeUnit, options::columns};

/// What is said of a file: columns, unit of time, sample time, whether it is to be resampled.
#[derive(Clone, Copy, Default)]
struct Said {
    columns: &'static str,
    unit: Option<TimeUnit>,
    sample_time_s: Option<f64>,
    resampled: bool,
}

const fn mapped(columns: &'static str) -> Said {
    Said { columns, unit: None, sample_time_s: None, resampled: false }
}

const fn at(columns: &'static str, sample_time_s: f64) -> Said {
    Said { sample_time_s: Some(sample_time_s), ..mapped(columns) }
}

const fn counted(columns: &'static str, sample_time_s: f64) -> Said {
    Said { unit: Some(TimeUnit::Samples), ..at(columns, sample_time_s) }
}

const fn in_unit(columns: &'static str, unit: TimeUnit) -> Said {
    Said { unit: Some(unit), ..mapped(columns) }
}

const fn resampled(said: Said) -> Said {
    Said { resampled: true, ..said }
}

const NOTHING: Said = mapped("");
const BY_POSITION: Said = mapped("t:1,r:2,u:3,y:4");
const LAB: Said = mapped("t:Time,r:Target,u:Stick,y:Cursor");

/// Each file with what is said of it; a file may stand here more than once.
const FILES: &[(&str, Said)] = &[
    ("acqknowledge.txt", mapped("t:sec,r:CH1,u:CH2,y:CH3")),
    ("acqknowledge.txt", at("r:CH1,u:CH2,y:CH3", 0.02)),
    ("acqknowledge_minutes.txt", mapped("t:min,r:CH1,u:CH2,y:CH3")),
    ("acqknowledge_minutes.txt", at("r:CH1,u:CH2,y:CH3", 0.02)),
    ("arduino.log", BY_POSITION),
    ("arduino.log", at("r:2,u:3,y:4", 0.02)),
    ("arduino_cut.log", BY_POSITION),
    ("arduino_labels.log", NOTHING),
    ("bioware.txt", mapped("t:abs time (s),r:Fx,u:Fy,y:Mz")),
    ("capstone.txt", mapped("t:1,r:2,u:3,y:4")),
    ("delsys.csv", mapped("t:1,r:2,u:4,y:6")),
    ("diadem.csv", NOTHING),
    ("diadem.csv", mapped("t:Zeit,r:Ziel,u:Kraft,y:Ort")),
    ("dspace.csv", mapped("t:2,r:3,u:4,y:5")),
    ("eprime.txt", NOTHING),
    ("excel_dates.csv", mapped("t:Time")),
    ("excel_fr.csv", mapped("t:Temps,r:Consigne,u:Commande,y:Curseur")),
    ("excel_us.csv", NOTHING),
    ("excel_web.xls", NOTHING),
    ("eyelink.asc", BY_POSITION),
    ("eyelink.asc", in_unit("t:1,r:2,u:3,y:4", TimeUnit::Milliseconds)),
    ("eyelink_blink.asc", in_unit("t:1,r:2,u:3,y:4", TimeUnit::Milliseconds)),
    ("eyelink_blink.asc", resampled(in_unit("t:1,r:2,u:3,y:4", TimeUnit::Milliseconds))),
    ("fortran.dat", BY_POSITION),
    ("haptics.log", mapped("t:2,r:4,u:6,y:8")),
    ("haptics_vectors.log", BY_POSITION),
    ("kinarm.csv", NOTHING),
    ("kinarm.csv", mapped("t:Time,r:Target X,u:Right: Hand force X,y:Right: Hand position X")),
    ("labchart.txt", NOTHING),
    ("labchart.txt", mapped("t:1,r:Target,u:Stick,y:Cursor")),
    ("labchart_values.txt", mapped("t:1,r:Target,u:Stick,y:Cursor")),
    ("labview.lvm", NOTHING),
    ("labview.lvm", mapped("t:X_Value,r:Target,u:Stick,y:Cursor")),
    ("labview_de.lvm", mapped("t:X_Value,r:Target,u:Stick,y:Cursor")),
    ("labview.tdms", NOTHING),
    ("labview_spreadsheet.txt", NOTHING),
    ("labview_spreadsheet.txt", BY_POSITION),
    ("libreoffice.csv", NOTHING),
    ("long.csv", NOTHING),
    ("markdown.md", NOTHING),
    ("matlab_display.txt", BY_POSITION),
    ("matlab_dlmwrite.txt", BY_POSITION),
    ("motion.c3d", NOTHING),
    ("msvc.csv", NOTHING),
    ("msvc.csv", resampled(NOTHING)),
    ("ndi_first_principles.txt", mapped("t:Frame,r:Marker_1 x,u:Marker_1 y,y:Marker_1 z")),
    ("ndi_first_principles.txt", counted("t:Frame,r:Marker_1 x,u:Marker_1 y,y:Marker_1 z", 0.02)),
    ("ndi_unseen.csv", counted("t:Frame,r:Marker_1 x,u:Marker_1 y,y:Marker_1 z", 0.02)),
    ("ndi_unseen.csv", resampled(counted("t:Frame,r:Marker_1 x,u:Marker_1 y,y:Marker_1 z", 0.02))),
    ("octave_text.txt", BY_POSITION),
    ("openbci.txt", at("r:EXG Channel 0,u:EXG Channel 1,y:EXG Channel 2", 0.02)),
    ("openbci.txt", mapped("t:Timestamp,r:EXG Channel 0,u:EXG Channel 1,y:EXG Channel 2")),
    ("opensignals.txt", NOTHING),
    ("opensignals.txt", at("r:3,u:4,y:5", 0.02)),
    ("opensim.mot", mapped("t:time,r:target,u:force,y:elbow_flexion")),
    ("opensim.trc", mapped("t:2,r:3,u:4,y:5")),
    ("optitrack.csv", mapped("t:Time (Seconds),r:3,u:6,y:7")),
    ("pandas_no_names.csv", mapped("t:2,r:3,u:4,y:5")),
    ("pandas_two_levels.csv", mapped("t:1,r:r,u:u,y:y")),
    ("phyphox.csv", mapped("t:Time,r:Acceleration x,u:Acceleration y,y:Acceleration z")),
    ("presentation.log", NOTHING),
    ("psychopy.csv", NOTHING),
    ("psychopy_lists.csv", NOTHING),
    ("pupil_labs.csv", mapped("t:gaze_timestamp,r:target_x,u:norm_pos_x,y:norm_pos_y")),
    ("python_on_windows.csv", NOTHING),
    ("qualisys.tsv", mapped("t:Time,r:handle X,u:handle Y,y:handle Z")),
    ("qualisys_no_names.tsv", at("r:1,u:2,y:3", 0.02)),
    ("recording.edf", NOTHING),
    ("records.json", NOTHING),
    ("rostopic.csv", mapped("r:field.target,u:field.stick,y:field.cursor")),
    ("samples.jsonl", NOTHING),
    ("shimmer.csv", mapped("t:Timestamp_Unix,r:Target,u:Stick,y:Cursor")),
    ("simulink_sideways.csv", NOTHING),
    ("simulink_sideways.csv", BY_POSITION),
    ("simulink_table.csv", mapped("r:yout_1,u:yout_2,y:yout_3")),
    ("simulink_timetable.csv", NOTHING),
    ("smi_begaze.txt", in_unit("t:Time,r:L POR X,u:L POR Y,y:R POR X", TimeUnit::Microseconds)),
    ("spike2_channels.txt", NOTHING),
    ("spike2_sheet.txt", mapped("t:Time,r:1 Target,u:2 Stick,y:3 Cursor")),
    ("tobii.tsv", NOTHING),
    ("tobii.tsv", mapped("t:Recording timestamp,r:Gaze point X,u:Pupil diameter left,y:Gaze point Y")),
    ("typeset.csv", NOTHING),
    ("unity.csv", mapped("t:timeMs,r:target.x,u:input.x,y:cursor.x")),
    ("unity_de.csv", NOTHING),
    ("vicon_nexus.csv", counted("t:Frame", 0.02)),
    ("vicon_two_blocks.csv", counted("t:Frame", 0.02)),
    ("visual3d.txt", counted("t:1,r:2,u:3,y:4", 0.02)),
    ("write_csv2.csv", NOTHING),
    ("xsens.txt", counted("t:PacketCounter,r:Roll,u:Pitch,y:Yaw", 0.02)),
    ("spike2_sheet.txt", LAB),
];

impl Said {
    fn options(self) -> Options {
        Options {
            columns: if self.columns.is_empty() { Default::default() } else { columns(self.columns).unwrap() },
            time_unit: self.unit,
            sample_time_s: self.sample_time_s,
            resample: self.resampled.then_some(Resampling::Linear),
            ..Options::default()
        }
    }

    fn words(self) -> String {
        let mut words = self.columns.to_owned();
        for more in [
            self.unit.map(|unit| format!("time_unit={}", unit.name())),
            self.sample_time_s.map(|s| format!("sample_time_s={s}")),
            self.resampled.then(|| "resample=linear".to_owned()),
        ]
        .into_iter()
        .flatten()
        {
            words.push_str(&format!(" {more}"));
        }
        if words.is_empty() { String::new() } else { format!(" ({})", words.trim()) }
    }
}

#[test]
fn recordings_of_programs_are_read_or_refused_as_the_table_says() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.join("tests/data/instruments");
    let mut unread: std::collections::BTreeSet<String> =
        std::fs::read_dir(&folder).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    assert!(unread.len() >= 60, "{}", unread.len());
    let (mut table, mut read) = (String::new(), 0);
    for (name, said) in FILES {
        unread.remove(*name);
        let bytes = std::fs::read(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let found = match exchange::read(&bytes, &said.options()) {
            Ok(reading) => {
                let own = &reading.trial.signals;
                if !reading.understood.resampled {
                    assert_eq!([&own.command, &own.control, &own.output], signals().each_ref(), "{name}");
                }
                read += 1;
                format!("read: {}", line(&reading))
            }
            Err(problem) => {
                assert!(problem.mend.as_ref().is_some_and(|mend| mend.len() > 10), "{name}: {problem}");
                format!("refused: {problem}")
            }
        };
        let _ = writeln!(table, "{name}{}: {found}", said.words());
    }
    assert!(unread.is_empty(), "files that nothing is said of: {unread:?}");
    assert!(read >= 40, "{read} are read");
    let path = root.join("tests/golden/instruments.txt");
    if std::env::var_os("VOLITION_BLESS").is_some() {
        std::fs::write(&path, &table).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap_or_default();
    for (found, expected) in table.lines().zip(golden.lines()) {
        assert_eq!(found, expected);
    }
    assert_eq!(table, golden);
}
