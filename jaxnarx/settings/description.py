"""All keys of a TOML description of records, as `--help` shows them.

The text stands here, without imports, so that help answers at once; `jaxnarx.data`
reads such files.
"""

DESCRIPTION = """All keys of a description of records:
    [data]
    sample_time = 0.1            # s; files with several rasters are brought to it
    time = "t"                   # a column, instead or beside it, to have it checked
    time_unit = "s"              # or "ms", "us", "min", "h": of that column's numbers
    missing = "refuse"           # or "mask", "split", "interpolate"
    root = "."                   # folder of the files, see below
    columns = ["speed", "NOx"]   # all, in order; only for CSV files without a header
    decimal = "."                # or ","
    delimiter = ","              # found out (comma, semicolon, tab) when left out
    encoding = "utf-8"           # or "cp1252", ...
    skip_rows = 0                # lines before the header
    unit_row = false             # a line of units follows the header
    table = "Sheet1"             # of files with several sheets, variables or groups
    preparation = "preparation.json"   # what `jaxnarx prepare` did to these files
    [channels.inputs]            # name = unit, in the order of the dataset's columns
    speed = "rpm"
    load = {column = "Md_rel", unit = "%"}   # where the file calls it otherwise
    [channels.outputs]
    NOx = "ppm"
    [records]
    files = ["bench1/*.csv", "!bench1/cold*.csv"]   # all of these but those
    # or parts: train = [...], validate = [...], test = [...]
    # of a long file: "long.csv @ 0:500" (seconds), "long.csv @ engine_on > 0.5"
    # of numbered columns: "runs.mat @ #1,2,5"
    groups = {cold = ["day1_*"], warm = ["day2_*"]}   # left out together, see below
    at_rest = ["steady.csv"]     # operating points, a row each, see below
    [physics]                    # what is known beforehand, by output, see below
    NOx = {increases_with = ["load"], longest_time_constant = 5.0}

Files are CSV, Parquet, Excel and OpenDocument sheets, MDF, MATLAB (4 to 7.3), HDF5 and
npz. One output and [records] are required, and where the files do not tell the time
themselves sample_time or time. Columns that no channel names are ignored.

Units of the files are converted to those stated here (bar, kPa; degC, K; rad/s, rpm).
Numbers under time that look like milliseconds are refused until their unit is stated,
here, by a unit row or in the column's name ("t_ms", "time [s]").

root is relative to the --root option (the root argument of read), else to the
environment variable JAXNARX_DATA, and stays inside; else it is relative to the folder
of the description. The patterns of [records] are relative to root and stay inside.

Each pattern's files come in alphabetical order, and each file is one record; behind @
stands what of it is one: a span of seconds from its first row, or every stretch in
which a column is above, or below, a number. A pattern that begins with ! takes its
files out of those that the patterns before it have chosen.

Where names of columns hold a # ({column = "Input#"}, time = "t#"), it stands for a
number, or for one of the words est, val, train and test: every one with which a file
has all columns makes a record, and those behind @ # are chosen.

groups names training records that are left out together where models are judged on what
they were not trained on; a list of lists of patterns serves as well. Records in no
group are put together where they repeat each other's inputs.

Rows of at_rest are operating points, measured with inputs that were held until all had
settled, in any order and without a time, in tables (no MDF). A search trains on them
beside the records; the errors that it shows are those of records. Cells of outputs that
were not measured at a point stay empty. With columns, all that these name are there.

physics names inputs with which an output at rest must not fall (increases_with) or not
rise (decreases_with). A search keeps these signs and tells what they cost. No feedback
and no filter is slower than longest_time_constant [s]; take it with a margin.
"""
