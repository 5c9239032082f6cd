"""Pages and pictures that are made from the program, so that they cannot lag behind it."""

from pathlib import Path


def write_all(folder: Path) -> None:
    """Write every generated page, picture and table into a folder."""
    from generator import api, architecture, commands, field, fields, figures, gallery, keys, notebook
    from generator.pages import remove_others

    (folder / "static").mkdir(parents=True, exist_ok=True)
    keys.write_keys(folder / "keys")
    commands.write_commands(folder / "commands")
    commands.write_statuses(folder)
    fields.write_fields(folder)
    api.write_api(folder / "api")
    field.write_tables(folder / "static")
    figures.write_figures(folder / "static")
    architecture.write_architecture(folder / "static")
    gallery.write_gallery(folder / "gallery", folder / "static")
    notebook.write_notebook(folder / "static")
    remove_others(folder)
