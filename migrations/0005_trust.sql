-- How far each quantity of a report may be used, and the numbers that lists show, so that no list opens a report. Written in
-- the transaction that finishes the analysis; a row for each trial (by its place in the analysis), estimator and quantity.
CREATE TABLE analysis_trust (
    analysis_id TEXT    NOT NULL REFERENCES analyses (id) ON DELETE CASCADE,
    -- The place of the trial among those of the analysis.
    position    INTEGER NOT NULL CHECK (position >= 0),
    -- Empty for what is no norm of controllers.
    estimator   TEXT    NOT NULL,
    quantity    TEXT    NOT NULL,
    value       REAL,
    low         REAL,
    high        REAL    CHECK ((low IS NULL) = (high IS NULL)),
    level       TEXT    NOT NULL CHECK (level IN ('not_identified', 'ok', 'read', 'do_not_use')),
    -- The same with its reasons, as JSON.
    trust       TEXT    NOT NULL,
    PRIMARY KEY (analysis_id, position, estimator, quantity)
) STRICT;

-- By which version of the rule an analysis was judged; NULL before it has a report, and for those of before.
ALTER TABLE analyses ADD COLUMN trust_rule INTEGER;
CREATE INDEX analyses_to_judge ON analyses (trust_rule, id) WHERE status = 'succeeded';

-- The units of a lab's signals, JSON {"output", "control"}: of everything recorded on a plant, unless a trial has its own.
ALTER TABLE plants ADD COLUMN units TEXT NOT NULL DEFAULT '{}';
ALTER TABLE trials ADD COLUMN units TEXT NOT NULL DEFAULT '{}';
