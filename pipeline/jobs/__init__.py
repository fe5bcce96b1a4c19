"""One file a stage: declared tables in, the stage's function, tables out."""
