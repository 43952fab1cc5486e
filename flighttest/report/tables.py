"""Every table of a document as files that other programs read: CSV, or Parquet with numbers where a column holds numbers."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from flighttest.datafiles import naming
from flighttest.report.document import Cell, Document, Table

KINDS = ("csv", "parquet")


def tables_of(document: Document) -> dict[str, Table]:
    """Tables with their file names: the section's id, counted where a section holds several."""
    found: dict[str, Table] = {}
    for section in document.sections:
        name, count = re.sub(r"[^\w-]+", "_", section.id) or "table", 1
        for block in section.blocks:
            if isinstance(block, Table):
                found[name if count == 1 else f"{name}-{count}"] = block
                count += 1
    return found


def write_tables(document: Document, folder: Path, kind: str) -> list[Path]:
    """Write each table whole, rows and columns that a terminal leaves out too; the paths written. kind: one of KINDS."""
    tables = tables_of(document)
    if tables:
        folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, table in tables.items():
        path = folder / f"{name}.{kind}"
        heads, rows = _heads(table), [[_text(cell) for cell in row] for row in table.rows]
        if kind == "csv":
            with naming(path), path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(heads)
                writer.writerows(rows)
        else:
            columns = {head: _column([row[i] for row in rows]) for i, head in enumerate(heads)}
            with naming(path):
                pq.write_table(pa.table(columns), path)
        written.append(path)
    return written


def _heads(table: Table) -> list[str]:
    """Headings, none twice and none empty."""
    heads: list[str] = []
    for name in table.columns:
        wanted, count = name or "note", 2
        while wanted in heads:
            wanted, count = f"{name or 'note'} {count}", count + 1
        heads.append(wanted)
    return heads


def _text(cell: Cell | str) -> str:
    return cell if isinstance(cell, str) else f"{cell.text} {cell.note}".strip()


def _column(values: list[str]) -> pa.Array:
    """Numbers where every value is one or missing ('-' or nothing), else text."""
    known = [None if v in ("", "-") else v for v in values]
    try:
        return pa.array([None if v is None else float(v) for v in known], pa.float64())
    except ValueError:
        return pa.array(values, pa.string())
