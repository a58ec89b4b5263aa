-- What a scientist says of a trial: a remark, and why it is left out of curves and comparisons; NULL where it is not. Its
-- recording and everything computed from it stay.
ALTER TABLE trials ADD COLUMN note TEXT NOT NULL DEFAULT '';
ALTER TABLE trials ADD COLUMN excluded TEXT CONSTRAINT excluded_with_a_reason CHECK (excluded <> '');
-- Trials of a study are listed in the order in which they were made.
CREATE INDEX trials_by_study ON trials (study_id, id);
