-- Files that were sent to be looked at before they are stored. Bounded in number and bytes, and gone after a day.
CREATE TABLE upload_drafts (
    id         TEXT    NOT NULL PRIMARY KEY,
    study_id   TEXT    NOT NULL REFERENCES studies (id) ON DELETE CASCADE,
    created_at INTEGER NOT NULL
) STRICT;
CREATE INDEX upload_drafts_by_study ON upload_drafts (study_id);

CREATE TABLE upload_files (
    draft_id TEXT    NOT NULL REFERENCES upload_drafts (id) ON DELETE CASCADE,
    -- The place among the files, from 0.
    position INTEGER NOT NULL CHECK (position >= 0),
    name     TEXT    NOT NULL,
    -- As it came; empty once the trial is stored.
    data     BLOB    NOT NULL,
    -- What a person says of the file, a JSON object.
    settings TEXT    NOT NULL DEFAULT '{}',
    -- The trial that it became.
    trial_id TEXT,
    PRIMARY KEY (draft_id, position)
) STRICT;

-- Whose recording a file is, nobody can know before it is stored: when a person is forgotten, so are the study's drafts.
CREATE TRIGGER drafts_forget AFTER DELETE ON subjects BEGIN
    DELETE FROM upload_drafts WHERE study_id = OLD.study_id;
END;
