"""Sheets of Excel, and the doubles nearest to the decimal text in them: python3 tests/exchange/sheets.py OUT

Needs openpyxl (here 3.1.5), which writes numbers with 16 digits or fewer: truth is what the sheet says, not what was given.
"""

import datetime
import json
import math
import os
import re
import struct
import sys
import zipfile

import openpyxl


def main():
    out = sys.argv[1]
    os.makedirs(out, exist_ok=True)
    rows = [[0.02 * i, math.sin(0.02 * i), math.cos(0.06 * i) - 0.5, (0.02 * i) ** 2 / 7] for i in range(30)]
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["t", "r", "u", "y"])
    for row in rows:
        sheet.append(row)
    book.save(f"{out}/plain.xlsx")
    with zipfile.ZipFile(f"{out}/plain.xlsx") as archive:
        xml = archive.read("xl/worksheets/sheet1.xml").decode()
    written = re.findall(r'<c r="([A-D])(\d+)"[^>]*><v>([^<]*)</v>', xml)
    bits = {column: [struct.pack(">d", float(text)).hex() for letter, row, text in written if letter == column and row != "1"]
            for column in "ABCD"}
    with open(f"{out}/plain.json", "w") as file:
        json.dump(bits, file)

    book = openpyxl.Workbook()
    book.active.title = "Notizen"
    book.active.append(["Versuch 3", "am Prüfstand 2"])
    sheet = book.create_sheet("Daten")
    sheet.append(["Prüfstand 2"])
    sheet.append([])
    sheet.append([None, "Zeit", "Ziel", "Kraft", "Ort", "Bemerkung"])
    sheet.append([None, "ms", "mm", "N", "mm", ""])
    for i, row in enumerate(rows):
        sheet.append([None, 20 * i, *row[1:], "Pause" if i == 7 else None])
    book.save(f"{out}/german.xlsx")

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["t", "r", "u", "y"])
    for i, row in enumerate(rows):
        sheet.append([datetime.datetime(2026, 11, 30, 12, 0, i) if i == 4 else row[0], *row[1:]])
    book.create_sheet("copy").append([1, 2, 3, 4, 5, 6])
    book.save(f"{out}/two_sheets.xlsx")
    del book["copy"]
    book.save(f"{out}/dates.xlsx")
    sheet["A6"] = 0.08
    sheet["A6"].number_format = "General"
    sheet["C9"] = "=1/0"
    book.save(f"{out}/formula.xlsx")


main()
