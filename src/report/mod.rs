//! Writers of what a run leaves: CSV, JSON, VTU and PNG; they compute nothing.
