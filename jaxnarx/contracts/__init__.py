"""Contracts of extensions, as checks that run over yours.

    JAXNARX_EXTENSIONS=my_module pytest --pyargs jaxnarx.contracts

imports `my_module` (several are separated by commas), which registers its extensions,
loads what installed packages name as extensions (`jaxnarx.extensions`), and runs every
check of a kind over every extension of it. A check is a function whose docstring is the
rule; `CHECKS` of the module of a kind lists them:

| kind | module | a check is given |
|---|---|---|
| validity function | `validity` | an instance, the number of its variables |
| selector | `selector` | the selector |
| partition | `partition` | the partition, names of its scheduling variables |
| candidate of identify | `candidate` | the function |
| analysis of reports | `analysis` | the function |
| engine | `engine` | the engine, two of its usual records |
| kind of file | `reader` | what writes an example, the suffix, a folder |
| target | `target` | the target, a folder |

Validity functions, partitions and kinds of files are registered with an `example`; what
it returns is said in the module. pytest is needed here and nowhere else.
"""
