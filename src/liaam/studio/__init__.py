"""The studio: annotate pictures, train, fit and relight in the browser, on this machine only.

``liaam studio FOLDER`` serves a page on the loopback (:mod:`liaam.studio.serving`). :mod:`liaam.studio.project` is the
folder with its pictures, template and landmark files. :mod:`liaam.studio.training` trains in a separate process,
:mod:`liaam.studio.model_store` holds the current model, and :mod:`liaam.studio.fits` fits. :mod:`liaam.studio.app` is
the web application, and :mod:`liaam.studio.safety` checks each request. Importing this package loads nothing heavy.
"""
