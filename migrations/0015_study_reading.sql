-- What a study's files do not say themselves, JSON {"columns", "time_unit", "sample_time_s", "resample"}: said once, and taken for
-- every file that is read into the study, as far as the request says nothing else.
ALTER TABLE studies ADD COLUMN reading TEXT NOT NULL DEFAULT '{}';
