"""Work for many processes: numbered units, handed to an executor that somebody else runs. It schedules nothing itself.

A job is cut into units: a file of a dataset, a region of a map. A unit can be done twice without harm, and it is done when
something appears whole: a file by its rename. So a job that is interrupted, or of which a worker was killed, is given again,
and goes on; the bytes are the same, whatever ran it.

    jaxcap score runs/ --contacts feet.yaml -o scores/ --jobs 2                  # a laptop: spawned processes
    jaxcap score runs/ --contacts feet.yaml -o scores/ --dask tcp://head:8786    # a cluster that is there
    jaxcap score runs/ --contacts feet.yaml -o scores/ --shard 0/3               # a part, in any queue

All workers see the same files, and have the same jaxcap and JAX. A Dask worker has one task thread: JAX has its own.

    dask scheduler                                         # over SSH, on one machine
    dask worker tcp://head:8786 --nthreads 1 --nworkers 4  # on each; as many as there is memory for, 1 GB each
    CUDA_VISIBLE_DEVICES=0 XLA_PYTHON_CLIENT_PREALLOCATE=false dask worker tcp://head:8786 --nthreads 1   # for each GPU

Slurm, by dask-jobqueue (PBS and LSF alike):

    from dask_jobqueue import SLURMCluster
    cluster = SLURMCluster(queue="cpu", cores=1, processes=1, job_cpu=4, memory="4GB", walltime="04:00:00")
    cluster.scale(jobs=64)
    print(cluster.scheduler_address)   # for --dask
    input("Enter ends it")

Slurm without a scheduler of Dask, an array of jobs (submit it again, and what failed is done):

    #!/bin/bash
    #SBATCH --array=0-63 --cpus-per-task=4
    jaxcap score runs/ --contacts feet.yaml -o scores/ --cache cache/ --shard $SLURM_ARRAY_TASK_ID/64

Kubernetes: dask-kubernetes makes a scheduler with an address. A worker's first unit waits seconds for JAX to compile, unless
the programs are in its user's cache folder, or in `--cache DIR` on a disk that all share. `python -m bench.engine` measures
what a unit costs, and how many bytes go in and out.

Begin with `units`, then `places` (this machine), `cluster` (Dask), `choice` (which), `shards` (parts), `ledger` (what of a
folder is done), `workers` (what runs there). May import `files`.
"""

from jaxcap.engine.choice import check_place as check_place
from jaxcap.engine.choice import chosen as chosen
from jaxcap.engine.ledger import Ledger as Ledger
from jaxcap.engine.ledger import open_ledger as open_ledger
from jaxcap.engine.places import Here as Here
from jaxcap.engine.places import Place as Place
from jaxcap.engine.places import processes as processes
from jaxcap.engine.shards import Shard as Shard
from jaxcap.engine.shards import shard_of as shard_of
from jaxcap.engine.units import Finished as Finished
from jaxcap.engine.units import over_units as over_units
from jaxcap.engine.workers import Terms as Terms
from jaxcap.engine.workers import Unit as Unit
