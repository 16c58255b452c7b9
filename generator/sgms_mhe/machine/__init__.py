"""The machine file: what a user writes, checked table by table, and the resolved machine that comes of it."""

from sgms_mhe.machine.axis import BASE_PARAMETERS, Friction, Plant, Smoothing, plant_content
from sgms_mhe.machine.code import Code, Compensation
from sgms_mhe.machine.diagnosis import DiagnosisTable
from sgms_mhe.machine.estimator import ArrivalCost, Disturbance, Estimator, Noise
from sgms_mhe.machine.fields import listing
from sgms_mhe.machine.file import Tables, json_schema
from sgms_mhe.machine.log_mapping import SEPARATORS, LogColumn, LogMapping, kinds_of, log_line, table_of_flags
from sgms_mhe.machine.log_units import BY_COLUMN, COUNTS, QUANTITIES, REQUIRED, Quantity, Role, normal_unit, split_unit
from sgms_mhe.machine.reading import (
    Layer,
    MachineFile,
    log_mapping,
    log_table,
    machine_file,
    merge_tables,
    read_log_table,
    read_machine_file,
)
from sgms_mhe.machine.resolved import Machine, ResolvedEffect, estimable_names
from sgms_mhe.machine.sampling import CLOSED_FORMS, DISPLACEMENT, Integrator, Sampling
from sgms_mhe.machine.units import LINEAR, OF_KIND, ROTARY, Kind, Units

__all__ = [
    "BASE_PARAMETERS",
    "BY_COLUMN",
    "CLOSED_FORMS",
    "COUNTS",
    "DISPLACEMENT",
    "LINEAR",
    "OF_KIND",
    "QUANTITIES",
    "REQUIRED",
    "ROTARY",
    "SEPARATORS",
    "ArrivalCost",
    "Code",
    "Compensation",
    "DiagnosisTable",
    "Disturbance",
    "Estimator",
    "Friction",
    "Integrator",
    "Kind",
    "Layer",
    "LogColumn",
    "LogMapping",
    "Machine",
    "MachineFile",
    "Noise",
    "Plant",
    "Quantity",
    "ResolvedEffect",
    "Role",
    "Sampling",
    "Smoothing",
    "Tables",
    "Units",
    "estimable_names",
    "json_schema",
    "kinds_of",
    "listing",
    "log_line",
    "log_mapping",
    "log_table",
    "machine_file",
    "merge_tables",
    "normal_unit",
    "plant_content",
    "read_log_table",
    "read_machine_file",
    "split_unit",
    "table_of_flags",
]
