"""Arrays in, arrays out: what knows no names and no files."""

from jaxnarx.arrays._least_squares import LeastSquaresFit as LeastSquaresFit
from jaxnarx.arrays._least_squares import least_squares as least_squares
from jaxnarx.arrays._least_squares import leverage as leverage
from jaxnarx.arrays._least_squares import solve_least_squares as solve_least_squares
from jaxnarx.arrays._minimise import QUIET_STEPS as QUIET_STEPS
from jaxnarx.arrays._minimise import ROUNDING_LOSS as ROUNDING_LOSS
from jaxnarx.arrays._minimise import Course as Course
from jaxnarx.arrays._minimise import Levenberg as Levenberg
from jaxnarx.arrays._minimise import Progress as Progress
from jaxnarx.arrays._minimise import Standing as Standing
from jaxnarx.arrays._minimise import minimise as minimise
from jaxnarx.arrays._minimise import value_at as value_at
from jaxnarx.arrays.blocks import map_blocks as map_blocks
from jaxnarx.arrays.contraction import contract as contract
from jaxnarx.arrays.contraction import positions as positions
from jaxnarx.arrays.criteria import information as information
from jaxnarx.arrays.factorisation import BLOCK_ROWS as BLOCK_ROWS
from jaxnarx.arrays.factorisation import accumulate as accumulate
from jaxnarx.arrays.factorisation import directions as directions
from jaxnarx.arrays.factorisation import quadratic as quadratic
from jaxnarx.arrays.factorisation import triangle as triangle
from jaxnarx.arrays.levenberg import AbstractProblem as AbstractProblem
from jaxnarx.arrays.levenberg import LevenbergState as LevenbergState
from jaxnarx.arrays.levenberg import Linear as Linear
from jaxnarx.arrays.normal_equations import gram as gram
from jaxnarx.arrays.normal_equations import ridge_solve as ridge_solve
from jaxnarx.arrays.programs import plain as plain
from jaxnarx.arrays.programs import program as program
from jaxnarx.arrays.programs import twin as twin
from jaxnarx.arrays.recurrence import free_run as free_run
from jaxnarx.arrays.recurrence import history_of as history_of
from jaxnarx.arrays.recurrence import linear_recurrence as linear_recurrence
from jaxnarx.arrays.recurrence import own_history as own_history
from jaxnarx.arrays.recurrence import polynomial_step as polynomial_step
from jaxnarx.arrays.recurrence import run_history as run_history
from jaxnarx.arrays.recurrence import sensitivities as sensitivities
from jaxnarx.arrays.recursive_least_squares import Recursion as Recursion
from jaxnarx.arrays.recursive_least_squares import (
    solve_recursively as solve_recursively,
)
from jaxnarx.arrays.recursive_least_squares import update_recursion as update_recursion
from jaxnarx.arrays.sizes import bucket as bucket
from jaxnarx.arrays.windows import lagged as lagged
from jaxnarx.arrays.windows import usable as usable
