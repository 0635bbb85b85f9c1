//! What a report says in words: what was asked, how it ended, where it comes from.

use crate::study::{Kind, Plan, Provenance, Status};

/// The name of the study: its folder, or its file.
pub(super) fn title(plan: &Plan) -> String {
    let file = plan.provenance.study_file.trim_end_matches(".toml");
    let name = file.strip_suffix("/study").unwrap_or(file);
    name.replace(['_', '/'], " ")
}

pub(super) fn question(plan: &Plan) -> &'static str {
    match plan.kind {
        Kind::Mesh => "Which mesh stands for this heart at rest, and how well does it follow what was drawn?",
        Kind::Simulate => "How does this heart beat with the parameters of the study, without any images?",
        Kind::Phantom => "Images of a heart whose truth is known: what they show, and what the truth is.",
        Kind::Track => "How does the wall move in these images? A model with fixed parameters is pulled along by their boundaries.",
        Kind::Personalise => {
            "Which parameters make the free model beat as the images show, how sure is that, and what can the model not explain?"
        }
        Kind::CompareBases => "What does it change how the base of the heart is held while the images are tracked?",
        Kind::CompareSchemes => "How near to the truth does each scheme of image forces come, and which of them hold?",
        Kind::CompareSolvers => "What do several solvers spend to find the same parameters?",
        Kind::Sensitivity => "Which inputs move which outputs of the model, and by how much?",
    }
}

/// How a run ended, and whether that is good.
pub(super) fn status(kind: Kind, status: Status) -> (String, bool) {
    let is_search = matches!(kind, Kind::Personalise | Kind::CompareSolvers);
    let (words, is_good) = match status {
        Status::Converged if is_search => ("Converged: the search came to its end.", true),
        Status::Converged => ("Finished.", true),
        Status::OnBound => ("Converged with a parameter on its bound: read that value as “at least” or “at most”.", false),
        Status::IterationLimit if is_search => ("Not converged: the iterations were used up. Read the values as a step on the way.", false),
        Status::IterationLimit => ("Not converged: the beats do not repeat yet.", false),
        Status::Stopped => ("Stopped by hand: this is what there was by then.", false),
        Status::Failed => ("Failed: what is shown was found until then, and should not be relied upon.", false),
    };
    (words.into(), is_good)
}

pub(super) fn provenance(provenance: &Provenance) -> Vec<(String, String)> {
    let revision = provenance.revision.map(|revision| format!(", revision {revision}")).unwrap_or_default();
    let program = format!("{} {}{revision}", provenance.program, provenance.version);
    let mut entries = vec![
        ("Program".to_owned(), program),
        ("Study".to_owned(), provenance.study_file.clone()),
        ("Hash of the study".to_owned(), provenance.study_hash.clone()),
    ];
    entries.extend(provenance.settings.iter().map(|setting| ("Set on the command line".to_owned(), setting.clone())));
    entries
}
