//! Maps as files: PGM with YAML as map_server reads them, and PNG for people.
