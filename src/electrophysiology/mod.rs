//! When each vertex is depolarised: the anisotropic eikonal model, [Billet2009] §2.
