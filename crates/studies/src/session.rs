//! The way through: plan, train, evaluate, draw, write.

use leadtime_runs::Tasks;
use tokio_util::sync::CancellationToken;

use crate::cache::EvalCache;
use crate::catalog::NamedStudy;
use crate::error::Error;
use crate::estimate::TrainingEstimate;
use crate::evaluate::Evaluator;
use crate::plan::{self, PlannedTraining, StudyPlan, bootstrap};
use crate::progress::{StudyObserver, TrainingWatch};
use crate::request::StudyRequest;
use crate::result::{StudyResult, TrainedRun};
use crate::train::{Crew, train};
use crate::write::Destination;
use crate::{draw, profile, provenance};

/// One or several studies, planned and checked.
#[derive(Debug)]
pub struct StudySession<'a> {
    tasks: &'a Tasks,
    request: StudyRequest,
    destination: Destination,
    plans: Vec<StudyPlan>,
    trainings: Vec<PlannedTraining>,
}

impl<'a> StudySession<'a> {
    /// Plans studies, and checks everything that can be checked before hours of training.
    ///
    /// # Errors
    ///
    /// If the request names something that does not exist, a setting is refused, a measure is unknown, a run was trained with
    /// something else than its name says, a page or the index would replace one that no study wrote, or the index cannot be made.
    pub fn plan(
        tasks: &'a Tasks,
        studies: Vec<NamedStudy>,
        request: StudyRequest,
    ) -> Result<Self, Error> {
        plan::check_choice(&studies, &request)?;
        profile::check_profiles(tasks, &studies, &request)?;
        let destination = Destination::new(&request, &studies);
        destination.check_index(&studies)?;
        studies.iter().try_for_each(|named| destination.check(&named.name))?;
        let plans = studies.into_iter().map(|named| StudyPlan::new(tasks, named, &request));
        let mut plans = plans.collect::<Result<Vec<_>, _>>()?;
        let trainings = plan::share(&mut plans);
        Ok(Self { tasks, request, destination, plans, trainings })
    }

    /// Lists the trainings of all studies, each once.
    pub fn trainings(&self) -> &[PlannedTraining] {
        &self.trainings
    }

    /// Reckons how long the trainings that are left will take.
    pub fn estimate(&self, crew: Crew) -> TrainingEstimate {
        TrainingEstimate::new(&self.trainings, crew)
    }

    /// Carries the studies out, one after the other.
    ///
    /// # Errors
    ///
    /// If a training fails, a policy cannot be evaluated, a file cannot be written, or the program is asked to end.
    pub async fn carry_out(
        &self,
        crew: Crew,
        observer: &mut dyn StudyObserver,
        shutdown: &CancellationToken,
    ) -> Result<(), Error> {
        let mut watch = TrainingWatch::new(self.trainings.clone());
        for plan in &self.plans {
            train(&plan.trainings(), crew, &mut watch, observer, shutdown).await?;
            observer.evaluating(&plan.named.name);
            let result = self.evaluate(plan, observer, shutdown)?;
            match self.destination.write(&result)? {
                Some(page) => observer.written(&page),
                None => observer.page(&result.markdown()),
            }
        }
        if let Some(index) = self.destination.write_index()? {
            observer.written(&index);
        }
        Ok(())
    }

    fn evaluate(
        &self,
        plan: &StudyPlan,
        observer: &mut dyn StudyObserver,
        shutdown: &CancellationToken,
    ) -> Result<StudyResult, Error> {
        let cache = EvalCache::new(&self.request.build);
        let mut evaluator = Evaluator::new(self.tasks, shutdown, cache);
        let mut parts = Vec::new();
        for planned in &plan.parts {
            let mut part = evaluator.part(planned)?;
            let stem = format!("{}-{}", plan.named.name, part.name);
            let figures = draw::draw(self.tasks, planned, &part, &stem)?;
            part.pictures = self.destination.write_figures(figures)?;
            parts.push(part);
        }
        observer.evaluated(&evaluator.cache);
        let runs = plan.trainings().into_iter().map(provenance::run);
        let runs: Vec<TrainedRun> = runs.collect::<Result<_, _>>()?;
        let study = &plan.named.study;
        Ok(StudyResult {
            study: plan.named.name.clone(),
            title: study.title.clone(),
            lead: study.lead.clone(),
            warnings: warnings(plan, &self.request),
            bootstrap: bootstrap(),
            provenance: provenance::details(plan, &self.request, &runs),
            parts,
        })
    }
}

/// Lists what a reader must know before quoting a number.
fn warnings(plan: &StudyPlan, request: &StudyRequest) -> Vec<String> {
    let mut warnings = Vec::new();
    if request.quick {
        let text = "Quick: one training seed and a fraction of the steps. It shows that everything works; its figures \
                    are not to be quoted.";
        warnings.push(text.to_owned());
    }
    if !request.set.is_empty() {
        let keys: Vec<String> = request.set.iter().map(|set| format!("`{}`", set.key())).collect();
        warnings.push(format!("Changed on the command line: {}.", keys.join(", ")));
    }
    if let Some(steps) = request.steps {
        warnings.push(format!("Every training has {steps} steps, by the command line."));
    }
    if request.seeds.is_some() {
        warnings.push("Training seeds are those of the command line, not the study's.".to_owned());
    }
    if !request.has_the_tables_episodes() {
        let (n, seed) = (request.episodes, request.eval_seed);
        let over = format!("Evaluated over {n} episodes per training seed");
        warnings.push(format!("{over}, from evaluation seed {seed} on."));
    }
    if plan.parts.iter().any(|planned| planned.profile.name != planned.part.profile) {
        warnings.push("The profile is that of the command line, not the study's.".to_owned());
    }
    if !(request.rows.is_empty() && request.parts.is_empty()) {
        warnings.push("Only some rows of the study are here.".to_owned());
    }
    warnings
}
