//! A study file as written, the plan it means, and the results found.
