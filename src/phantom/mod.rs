//! Hearts whose truth is known: idealised anatomies and synthetic cine, [Billet2009] §6.1.
