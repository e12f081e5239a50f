# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files and processes, without physics: atomic files (`files.whole_file`), results on disk
(`cache.content_key`), untrusted documents (`documents.read_yaml`), pages of reports
(`page.write_page`), progress, workers (`worker_pool.pool`)."""
