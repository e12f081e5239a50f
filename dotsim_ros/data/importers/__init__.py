# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Importers of published recordings on real gels: each reads a set as it was published, checks it,
and writes it as a data set."""
