"""Tables of the database, and their migration from earlier versions."""

MIGRATIONS = (
    """
CREATE TABLE recordings (
    id TEXT PRIMARY KEY, created_at TEXT NOT NULL, size_bytes BIGINT NOT NULL, sha256 TEXT NOT NULL,
    views INTEGER NOT NULL, missing TEXT NOT NULL, string_radius_m DOUBLE PRECISION,
    table_z_m DOUBLE PRECISION NOT NULL, provenance TEXT NOT NULL
);
CREATE TABLE scans (
    id TEXT PRIMARY KEY, mode TEXT NOT NULL, recording TEXT REFERENCES recordings (id), method TEXT NOT NULL,
    string_radius_m DOUBLE PRECISION, state TEXT NOT NULL, stage TEXT, fraction DOUBLE PRECISION NOT NULL,
    created_at TEXT NOT NULL, started_at TEXT, ended_at TEXT, summary TEXT, problem TEXT
);
""",
    """
CREATE TABLE views (
    scan TEXT NOT NULL REFERENCES scans (id), view INTEGER NOT NULL, state TEXT NOT NULL, reason TEXT,
    changed_at TEXT NOT NULL, PRIMARY KEY (scan, view)
);
""",
    """
CREATE TABLE calibrations (
    id TEXT PRIMARY KEY, kind TEXT NOT NULL, board TEXT, poses INTEGER NOT NULL, warnings TEXT NOT NULL,
    calibration_sha256 TEXT, state TEXT NOT NULL, stage TEXT,
    fraction DOUBLE PRECISION NOT NULL, coverage DOUBLE PRECISION NOT NULL,
    created_at TEXT NOT NULL, started_at TEXT, ended_at TEXT, activated_at TEXT, result TEXT, verification TEXT,
    problem TEXT
);
CREATE TABLE calibration_views (
    calibration TEXT NOT NULL REFERENCES calibrations (id), view INTEGER NOT NULL, state TEXT NOT NULL, reason TEXT,
    corners INTEGER, possible INTEGER, changed_at TEXT NOT NULL, PRIMARY KEY (calibration, view)
);
CREATE TABLE scan_errors (
    scan TEXT PRIMARY KEY REFERENCES scans (id), calibration_sha256 TEXT NOT NULL, likeliest TEXT NOT NULL,
    information TEXT NOT NULL, vector TEXT NOT NULL
);
CREATE INDEX scan_errors_of ON scan_errors (calibration_sha256, scan);
""",
    """
ALTER TABLE scans ADD COLUMN source TEXT;
ALTER TABLE scans ADD COLUMN asked_by TEXT;
ALTER TABLE scans ADD COLUMN kept INTEGER NOT NULL DEFAULT 0;
ALTER TABLE scans ADD COLUMN calibration_sha256 TEXT;
ALTER TABLE scans ADD COLUMN inputs TEXT;
ALTER TABLE scans ADD COLUMN files TEXT;
ALTER TABLE views ADD COLUMN offset_bytes BIGINT;
ALTER TABLE views ADD COLUMN size_bytes BIGINT;
ALTER TABLE views ADD COLUMN sha256 TEXT;
CREATE INDEX scans_of ON scans (recording);
CREATE INDEX scans_again ON scans (source);
CREATE INDEX scans_in ON scans (state, id);
CREATE TABLE idempotency_keys (
    caller TEXT NOT NULL, idempotency_key TEXT NOT NULL, body_sha256 TEXT NOT NULL,
    scan TEXT NOT NULL REFERENCES scans (id), created_at TEXT NOT NULL, PRIMARY KEY (caller, idempotency_key)
);
CREATE INDEX idempotency_keys_of ON idempotency_keys (scan);
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT, scan TEXT NOT NULL REFERENCES scans (id), at TEXT NOT NULL,
    kind TEXT NOT NULL, data TEXT NOT NULL
);
CREATE INDEX events_of ON events (scan, id);
CREATE TABLE cell_fault (id INTEGER PRIMARY KEY CHECK (id = 1), slug TEXT NOT NULL, reason TEXT NOT NULL,
    at TEXT NOT NULL
);
CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT, at TEXT NOT NULL, who TEXT NOT NULL, role TEXT NOT NULL, what TEXT NOT NULL,
    scan TEXT, cell TEXT NOT NULL, status INTEGER NOT NULL, result TEXT
);
CREATE TRIGGER audit_is_not_changed BEFORE UPDATE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever added to'); END;
CREATE TRIGGER audit_is_not_deleted BEFORE DELETE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever added to'); END;
CREATE TABLE lasting_errors (
    scan TEXT PRIMARY KEY, calibration_sha256 TEXT NOT NULL, likeliest TEXT NOT NULL, information TEXT NOT NULL,
    vector TEXT NOT NULL
);
INSERT INTO lasting_errors SELECT * FROM scan_errors;
DROP TABLE scan_errors;
ALTER TABLE lasting_errors RENAME TO scan_errors;
CREATE INDEX scan_errors_of ON scan_errors (calibration_sha256, scan);
""",
    """
ALTER TABLE calibration_views ADD COLUMN rms_px DOUBLE PRECISION;
ALTER TABLE calibration_views ADD COLUMN cells TEXT;
""",
    """
ALTER TABLE recordings ADD COLUMN name TEXT;
UPDATE recordings SET created_at = (SELECT created_at FROM scans WHERE scans.id = recordings.id)
    WHERE id IN (SELECT id FROM scans);
""",
    """
ALTER TABLE scans RENAME COLUMN problem TO failure;
ALTER TABLE calibrations RENAME COLUMN problem TO failure;
UPDATE scans SET failure = json_object(
        'slug', substr(json_extract(failure, '$.type'), 16), 'message', json_extract(failure, '$.detail'))
    WHERE json_valid(failure) AND json_extract(failure, '$.type') LIKE 'urn:pointchain:%';
UPDATE calibrations SET failure = json_object(
        'slug', substr(json_extract(failure, '$.type'), 16), 'message', json_extract(failure, '$.detail'))
    WHERE json_valid(failure) AND json_extract(failure, '$.type') LIKE 'urn:pointchain:%';
UPDATE events SET data = json_remove(json_set(data, '$.failure', CASE
        WHEN json_extract(data, '$.problem.type') IS NULL THEN json('null')
        ELSE json_object('slug', substr(json_extract(data, '$.problem.type'), 16),
            'message', json_extract(data, '$.problem.detail')) END), '$.problem')
    WHERE kind = 'state' AND json_valid(data);
""",
    """
ALTER TABLE scans RENAME COLUMN asked_by TO requested_by;
ALTER TABLE calibration_views RENAME COLUMN possible TO board_corners;
UPDATE calibrations SET result = replace(result, '"words":', '"message":'),
    verification = replace(verification, '"words":', '"message":');
UPDATE calibrations SET result = replace(result, '"refuses":', '"blocking":');
UPDATE calibrations SET result = replace(result, '"left_out_m":', '"loo_error_m":');
UPDATE calibrations SET result = replace(result, '"eight_views_m":', '"repeatability_95_m":');
UPDATE calibrations SET result = replace(result, '"off_m":', '"deviation_m":'),
    verification = replace(verification, '"off_m":', '"deviation_m":');
UPDATE calibrations SET result = replace(result, '"off_rad":', '"deviation_rad":'),
    verification = replace(verification, '"off_rad":', '"deviation_rad":');
UPDATE calibrations SET result = replace(result, '"worst_m":', '"max_deviation_m":'),
    verification = replace(verification, '"worst_m":', '"max_deviation_m":');
UPDATE calibrations SET result = replace(result, '"worst_rad":', '"max_deviation_rad":'),
    verification = replace(verification, '"worst_rad":', '"max_deviation_rad":');
UPDATE calibrations SET result = replace(result, '"board_moved_m":', '"board_displacement_m":'),
    verification = replace(verification, '"board_moved_m":', '"board_displacement_m":');
UPDATE calibrations SET result = replace(result, '"board_turned_rad":', '"board_rotation_rad":'),
    verification = replace(verification, '"board_turned_rad":', '"board_rotation_rad":');
UPDATE calibrations SET result = replace(result, '"side":', '"convention":');
UPDATE calibrations SET result = replace(result, '"K_told":', '"K_given":');
UPDATE calibrations SET result = replace(result, '"schema_version": 1,', '"schema_version": 2,');
""",
    """
ALTER TABLE scans ADD COLUMN all_grasps INTEGER NOT NULL DEFAULT 0;
ALTER TABLE scans ADD COLUMN simulated INTEGER;
ALTER TABLE recordings ADD COLUMN simulated INTEGER;
UPDATE scans SET summary = json_object(
        'chains', json_extract(summary, '$.chains'), 'crossings', json_extract(summary, '$.crossings'),
        'verdict', 'review',
        'doubts', (SELECT json_group_array(json_object(
            'code', 'pointchain-1', 'severity', 'doubt', 'message', value))
            FROM json_each(summary, '$.warnings') WHERE key < 20),
        'doubt_count', json_array_length(summary, '$.warnings'), 'note_count', 0,
        'partial', json(CASE json_extract(summary, '$.partial') WHEN 1 THEN 'true' ELSE 'false' END))
    WHERE json_valid(summary) AND json_type(summary, '$.warnings') = 'array';
UPDATE events SET data = json_set(data, '$.summary', json_object(
        'chains', json_extract(data, '$.summary.chains'), 'crossings', json_extract(data, '$.summary.crossings'),
        'verdict', 'review',
        'doubts', (SELECT json_group_array(json_object(
            'code', 'pointchain-1', 'severity', 'doubt', 'message', value))
            FROM json_each(data, '$.summary.warnings') WHERE key < 20),
        'doubt_count', json_array_length(data, '$.summary.warnings'), 'note_count', 0,
        'partial', json(CASE json_extract(data, '$.summary.partial') WHEN 1 THEN 'true' ELSE 'false' END)))
    WHERE kind = 'state' AND json_valid(data) AND json_type(data, '$.summary.warnings') = 'array';
""",
    """
ALTER TABLE scans ADD COLUMN timing TEXT;
ALTER TABLE views ADD COLUMN move_s DOUBLE PRECISION;
ALTER TABLE views ADD COLUMN settle_s DOUBLE PRECISION;
ALTER TABLE views ADD COLUMN exposure_s DOUBLE PRECISION;
""",
    """
ALTER TABLE scans ADD COLUMN views;
""",
)
"""Scripts that create the tables and migrate them. The database's `user_version` is the number of scripts applied.

The eighth script renames members of JSON documents as text. A quote inside a JSON string is escaped, so `"name":` is
always the name of a member. The ninth gives the summaries of earlier scans a verdict. Their models have the schema
`pointchain/1`, whose messages have no codes, so the verdict is `review`. The column `views` of `scans` has no type,
because it is a number or text.
"""
VERSION = len(MIGRATIONS)
