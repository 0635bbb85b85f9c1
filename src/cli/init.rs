//! `cardiotwin init`: a commented study file for the images, labels or mesh that somebody has.

use super::arguments::InitArguments;
use super::exit::Exit;
use super::print;
use crate::study::{DraftInputs, InitError, MaskFiles, draft_study, write_study};

/// Writes a study file and says what each file was taken for.
pub(super) fn write(arguments: InitArguments) -> anyhow::Result<Exit> {
    let InitArguments { files, epicardium, endocardium_lv, endocardium_rv, frame, output, force } = arguments;
    if output.exists() && !force {
        return Err(InitError::Exists { file: output }.into());
    }
    let masks = epicardium.zip(endocardium_lv).map(|(epicardium, endocardium_lv)| MaskFiles { epicardium, endocardium_lv, endocardium_rv });
    let draft = draft_study(&DraftInputs { files, masks, frame }, &output)?;
    write_study(&output, &draft)?;
    let notes: String = draft.notes.iter().map(|note| format!("{note}\n")).collect();
    let file = output.display();
    print(&format!("{notes}the study is in {file}; look through it, then: cardiotwin run {file}\n"))?;
    Ok(Exit::Done)
}
