// What the server is asked.

const token = new URLSearchParams(location.search).get("token");

function address(path, query = {}) {
  const all = new URLSearchParams(token ? { ...query, token } : query);
  return `./api/${path}${all.size > 0 ? `?${all}` : ""}`;
}

async function answered(path, query) {
  const answer = await fetch(address(path, query));
  if (!answer.ok) throw new Error((await answer.json()).error);
  return answer;
}

const get = async (path, query) => (await answered(path, query)).json();

/** All runs. */
export const runs = () => get("runs");

/** How a run stands in a list of all, in a line: where that is another one, there is something to read. */
export function standing(list, id) {
  const run = list.runs.find((other) => other.id === id);
  return run ? `${run.state} ${run.environment_steps}` : "gone";
}

/** What a run is. */
export const details = (id) => get(`runs/${encodeURIComponent(id)}`);

/** A run's updates from one on. */
export const updates = (id, from) => get(`runs/${encodeURIComponent(id)}/updates`, { from });

/** The processes of a run; null where nobody trains it. */
export const processes = (id) => get(`runs/${encodeURIComponent(id)}/processes`);

/** What the processes of a run have printed. */
export const output = (id) => get(`runs/${encodeURIComponent(id)}/output`);

const ofEpisode = (run, collection, row) => `runs/${encodeURIComponent(run)}/episodes/${encodeURIComponent(collection)}/${row}`;

/** The rows of a collection of episodes from one on. */
export function episodes(run, collection, generation, from) {
  return get(`runs/${encodeURIComponent(run)}/episodes/${encodeURIComponent(collection)}`, { generation, from });
}

/** An episode: its name is run, collection and row. */
export const episode = (...name) => get(ofEpisode(...name));

/** An episode's solids where they were; null for a task without. */
export const scenes = (...name) => get(`${ofEpisode(...name)}/scenes`);

/** Pictures of some of an episode's states, as its environment renders them: the number of the state, and a file. */
export async function pictures(...name) {
  const bytes = await (await answered(`${ofEpisode(...name)}/pictures`)).arrayBuffer();
  const [view, found] = [new DataView(bytes), []];
  for (let at = 0; at < bytes.byteLength;) {
    const [state, length] = [view.getUint32(at, true), view.getUint32(at + 4, true)];
    at += 8;
    found.push({ state, file: new Blob([bytes.slice(at, at + length)], { type: "image/png" }) });
    at += length;
  }
  return found;
}

/** What a reward model says of an episode's observations; the newest where no checkpoint is named. */
export const proximity = (name, checkpoint) => get(`${ofEpisode(...name)}/proximity`, checkpoint ? { checkpoint } : {});

/** What it says of the agent on every free cell of an episode's grid. */
export const grid = (name, checkpoint) => get(`${ofEpisode(...name)}/grid`, checkpoint ? { checkpoint } : {});

/** What an episode would have earned from another reward: settings such as `reward.form=absolute`, another run's model. */
export function reward(name, settings, model) {
  return get(`${ofEpisode(...name)}/reward`, { with: settings, ...(model ? { model } : {}) });
}

/** Calls `onruns` with every new list, `onconnection` with whether the server is there. */
export function listen(onruns, onconnection) {
  const source = new EventSource(address("events"));
  source.addEventListener("runs", (event) => onruns(JSON.parse(event.data)));
  source.addEventListener("open", () => onconnection(true));
  source.addEventListener("error", () => {
    onconnection(false);
    // A browser gives up for good when the answer is no stream of events.
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(onruns, onconnection), 2000);
  });
}
