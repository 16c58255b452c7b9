"""Log files as people have them: a file of any format and dialect into a log in SI units, step by step.

Each step is a pure function whose result is a frozen dataclass, which `sgms-mhe inspect` prints:

    bytes -> text (encoding)                                          encoding
    text -> dialect: header, unit row, separator, decimal mark        dialect, decimals, stamps, key_rows
    a line for each variable -> a column for each                     long_format
    file -> table of named columns                                    text, mat, mat73, hdf5, numpy_files, ...
    table + [log] -> which column is which quantity, in what unit     sources, names
    values -> SI units, on one clock                                  quantities, clocks
    time -> rate, jitter, gaps; uneven time onto a grid               timing, resampling
    log + machine -> values implausible of this axis                  plausibility

`following` takes a text through the same steps while it grows.

No library reads text as this room has to: pandas and polars take a dialect that somebody states, and neither of them
tells a unit row from data, a decimal comma from a separator, or a summary from a sample; guessing an encoding is not
needed where files are UTF-8, UTF-16 or Latin-1. Left for a library is the fast loop over numbers, numpy's
loadtxt. Formats with containers of their own are read by the libraries that define them (h5py, pyarrow, asammdf).
"""
