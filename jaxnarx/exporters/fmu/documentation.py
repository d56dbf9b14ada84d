"""documentation/index.html of an FMU: what its variables are and what time means."""

from collections.abc import Sequence
from html import escape

from jaxnarx.exporters.fmu.variables import Quantity, summed_outputs
from jaxnarx.exporters.form import SampleProgram
from jaxnarx.exporters.interpret import STARTS

SAMPLES_TEXT = """The model is sampled: y(t) is made from u(t) and from what came
before, and is known at t = start time + n T only, with n counted and T = {step} s.
Inputs and outputs are discrete: they are held, not interpolated."""
INITIAL_TEXT = """In initialization mode the outputs are y at the start time, from the
inputs as they are set; the run starts from what the parameter <code>start</code>
says."""
DELAY_TEXT = """<code>doStep(t, T)</code> takes the sample at t, with the inputs that
are set, and returns its outputs: behind it, at the communication point t + T, they are
y(t). A recording by communication points therefore lies one sample behind the model's
own. Whoever wants it to match sets u(t + T) before <code>doStep(t, T)</code>: then y(t
+ T) is there at t + T, and what is before the first step belongs to what the run starts
from."""
EVENTS_TEXT = """With event mode there is no delay: in event mode at t, set u(t), call
<code>updateDiscreteStates</code> and get y(t), as often as inputs change; a later step
keeps the last. Every <code>doStep</code> asks for the next event, because a sample is
due at its end. Without event mode it is as in FMI 2.0:"""
STEPS_TEXT = """A step of k T takes k samples with the same inputs. A step that does not
begin where the last has ended, is no multiple of T (within a share of 1e-9 and the
rounding of times), or ends behind the stop time, is refused with an error and changes
nothing."""
SLOPES_TEXT = """Directional derivatives are exact: of the reported outputs by the
inputs and by the past outputs <code>past.*</code>, of the sample that the next step
takes (in event mode, of the sample at hand). Where an output is held at a bound they
are zero."""
TOTALS_TEXT = """<code>total.*</code> are the sums of outputs that are rates over time,
from the first sample of the run up to the one that is told: g of g/s, kg of kg/h, kJ of
kW. Once an output was not a number its total is none."""
MAPS_TEXT = """<code>rest.*</code> are maps of outputs at rest over the inputs that
matter most, with the points of their axes: constants, which terminals group as
FMI-LS-STRUCT wants it. An output that does not come to rest at all points of its map
has none."""
STATE_TEXT = """State is got, set and serialised as a whole, time and inputs included;
what was serialised by another model is refused."""
LEARNING_TEXT = """While <code>learn</code> is 1 the coefficients follow the engine by
recursive least squares: every sample that is taken learns from
<code>measured.*</code> as it is set then, NaN where an output is not measured, and
from nothing outside of the domain. With 0 they stay. Measured outputs have to be
connected in any case: the run begins from them, and a model that was set to learn from
measured regressors predicts every sample from the measured ones before, as its C does.
<code>rmse.*</code> and the values beside are of the last whole window that was
taken. The coefficients are a part of the state, which is got, set and
serialised; derivatives are not provided."""
SOURCES_TEXT = """For another platform, compile the files of <code>sources</code> as C99
into a shared library, with the mathematical library. Linked statically, define
<code>FMI{version}_FUNCTION_PREFIX</code> as <code>{name}_</code>."""


def page(
    program: SampleProgram,
    variables: Sequence[Quantity],
    version: int,
    *,
    learns: bool = False,
) -> str:
    """The page; `learns`: of a model whose coefficients follow the engine."""
    texts = [SAMPLES_TEXT.format(step=f"{program.sample_time:g}"), INITIAL_TEXT]
    texts += [EVENTS_TEXT] if version == 3 else []
    texts += [DELAY_TEXT, STEPS_TEXT, LEARNING_TEXT if learns else SLOPES_TEXT]
    texts += [TOTALS_TEXT] if summed_outputs(program) else []
    texts += [MAPS_TEXT] if any(v.shape for v in variables) else []
    texts += [STATE_TEXT]
    texts += [escape(note) for note in program.notes]
    texts += [SOURCES_TEXT.format(version=version, name=program.name)]
    starts = "".join(f"<li><code>{k}</code>: {v}</li>\n" for k, v in STARTS.items())
    rows = "".join(
        f"<tr><td>{escape(v.name)}</td><td>{v.causality}</td><td>{escape(v.unit)}</td>"
        f"<td>{escape(v.about)}</td></tr>\n"
        for v in variables
    )
    body = "".join(f"<p>{text}</p>\n" for text in texts)
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{program.name}</title></head>
<body>
<h1>{program.name}</h1>
<h2>Time</h2>
{body}<h2>Start</h2>
<ul>
{starts}</ul>
<h2>Variables</h2>
<table>
<tr><th>name</th><th>kind</th><th>unit</th><th></th></tr>
{rows}</table>
</body>
</html>
"""
