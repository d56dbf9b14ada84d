"""A self-test in C with golden vectors."""

import math

import numpy as np

from jaxnarx.exporters.code import digits
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.target import Golden


def selftest(program: SampleProgram, golden: Golden) -> str:
    """The text of a program that returns 0 where the model does as at home."""
    name, upper = program.name, program.name.upper()
    inputs, measured = golden["inputs"], golden["measured"]
    outputs = golden["outputs"]

    def matrix(what: str, x: np.ndarray, pad: str = "    ") -> list[str]:
        # where nothing is reported, nothing is expected
        rows = [
            ", ".join("NAN" if math.isnan(v) else digits(v) for v in row) for row in x
        ]
        return [
            f"{pad}static const double {what}[{x.shape[0]}][{x.shape[1]}] = {{",
            *(f"{pad}    {{{row}}}," for row in rows[:-1]),
            f"{pad}    {{{rows[-1]}}}",
            f"{pad}}};",
        ]

    return (
        "\n".join(
            [
                "/* Golden vectors: what the model does in its home. Returns 0.",
                " * For a machine with a screen: stdio.h is no part of the model. */",
                f'#include "{name}.h"',
                "",
                "#include <math.h>",
                "#include <stdio.h>",
                "",
                f"#ifdef {upper}_SINGLE",
                "#define TOLERANCE 1e-4",
                "#else",
                "#define TOLERANCE 1e-11",
                "#endif",
                "",
                "int main(void)",
                "{",
                *matrix("inputs", inputs),
                *matrix("measured", measured),
                *matrix("expected", outputs),
                f"    {name}_state s;",
                f"    {name}_out out;",
                f"    {name}_real u[{upper}_INPUTS];",
                f"    {name}_real y[{upper}_COMPUTED];",
                "    double worst = 0.0;",
                "    double scale = 0.0;",
                "    int wrong = 0;",
                "    int t;",
                "    int k;",
                f"    for (t = 0; t < {len(inputs)}; t++) {{",
                f"        for (k = 0; k < {upper}_INPUTS; k++) {{",
                f"            u[k] = ({name}_real)inputs[t][k];",
                "        }",
                f"        if (t <= {upper}_HISTORY) {{",
                f"            for (k = 0; k < {upper}_COMPUTED; k++) {{",
                f"                y[k] = ({name}_real)measured[t][k];",
                "            }",
                "        }",
                "        if (t == 0) {",
                f"            {name}_begin(&s, u, y);",
                "        }",
                f"        if (t < {upper}_HISTORY) {{",
                f"            {name}_observe(&s, u, y);",
                "            continue;",
                "        }",
                f"        {name}_step(&s, u, &out);",
                f"        for (k = 0; k < {upper}_REPORTED; k++) {{",
                f"            const double right = expected[t - {upper}_HISTORY][k];",
                "            const double off = (double)out.reported[k] - right;",
                "            const double size = (off < 0.0) ? -off : off;",
                "            const double far = (right < 0.0) ? -right : right;",
                "            const int no = isnan(out.reported[k]);",
                "            if ((isnan(right) != 0) != (no != 0)) {",
                "                wrong = 1;",
                "            }",
                "            worst = (size > worst) ? size : worst;",
                "            scale = (far > scale) ? far : scale;",
                "        }",
                "    }",
                '    (void)printf("largest difference %.3g of %.3g\\n", worst, scale);',
                "    return ((wrong == 0) && (worst <= (TOLERANCE * scale))) ? 0 : 1;",
                "}",
            ]
        )
        + "\n"
    )
