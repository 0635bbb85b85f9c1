//! The proactive tracker: image forces and block-matched base, [Billet2009] §4 and §5.
