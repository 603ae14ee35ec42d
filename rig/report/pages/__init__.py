"""Pages: templates, HTML and SVG elements, plots and views of pages that commands write, and a run page's server."""
