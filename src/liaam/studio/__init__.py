"""The studio: annotate pictures, train, fit and relight in the browser, on this machine only.

``liaam studio FOLDER`` serves a page on the loopback (:mod:`liaam.studio.serving`). :mod:`liaam.studio.project` is the
folder with its pictures, template and landmark files, and names its parts; :mod:`liaam.studio.training` learns from it
in a process of its own (:mod:`liaam.studio.training_process`); :mod:`liaam.studio.model_store` has the model in use;
:mod:`liaam.studio.fits` fits; :mod:`liaam.studio.app` joins them and answers the page; :mod:`liaam.studio.safety`
stands before all of it. Nothing heavy is imported here.
"""
