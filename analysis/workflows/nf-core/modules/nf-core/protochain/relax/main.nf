process PROTOCHAIN_RELAX {
    tag "$meta.id"
    label 'process_medium'

    conda "${moduleDir}/environment.yml"
    container "${ workflow.containerEngine in ['singularity', 'apptainer'] && !task.ext.singularity_pull_docker_container ?
        'https://depot.galaxyproject.org/singularity/protochain:0.2.0--pyhdfd78af_0' :
        'biocontainers/protochain:0.2.0--pyhdfd78af_0' }"

    input:
    tuple val(meta), path(model)

    output:
    tuple val(meta), path("${prefix}.${extension}"), emit: model
    tuple val(meta), path("${prefix}.json")        , emit: record
    tuple val("${task.process}"), val('protochain'), eval("protochain --version | sed 's/protochain //'"), emit: versions_protochain, topic: versions

    when:
    task.ext.when == null || task.ext.when

    script:
    def args  = task.ext.args ?: ''
    prefix    = task.ext.prefix ?: "${meta.id}_relaxed"
    extension = model.name.contains('.cif') ? 'cif' : 'pdb'
    """
    protochain relax \\
        ${model} \\
        -o ${prefix}.${extension} \\
        --threads ${task.cpus} \\
        --json \\
        ${args} \\
        > ${prefix}.json || [ \$? -eq 3 ]
    """

    stub:
    prefix    = task.ext.prefix ?: "${meta.id}_relaxed"
    extension = model.name.contains('.cif') ? 'cif' : 'pdb'
    """
    touch ${prefix}.${extension}
    touch ${prefix}.json
    """
}
