// Requests to the server.

const token = new URLSearchParams(location.search).get("token");

function address(path, query = {}) {
  const all = String(new URLSearchParams(token ? { ...query, token } : query));
  return `./api/${path}${all ? `?${all}` : ""}`;
}

async function answered(path, query, signal) {
  const answer = await fetch(address(path, query), { signal });
  if (!answer.ok) throw new Error(reason(await answer.text()) || `status ${answer.status}`);
  return answer;
}

/** Returns why a request was refused: the server's line, or plain text where a request does not reach its handler. */
function reason(text) {
  try {
    return JSON.parse(text).error;
  } catch {
    return text;
  }
}

const get = async (path, query, signal) => (await answered(path, query, signal)).json();

/**
 * Returns a line on a run's state in the list of all runs. When it changes, there is something new to read. The time
 * grows with every update, also of a method that takes no environment steps.
 */
export function standing(list, id) {
  const run = list.runs.find((other) => other.id === id);
  return run ? `${run.state} ${run.wall_s}` : "gone";
}

/** Gets the details of a run. */
export const details = (id) => get(`runs/${encodeURIComponent(id)}`);

/** Gets a run's updates from index `from` on. */
export const updates = (id, from) => get(`runs/${encodeURIComponent(id)}/updates`, { from });

/** Gets the processes of a run; null if it is not being trained. */
export const processes = (id) => get(`runs/${encodeURIComponent(id)}/processes`);

/** Gets the output of a run's processes. */
export const output = (id) => get(`runs/${encodeURIComponent(id)}/output`);

const ofEpisode = (run, collection, row) => `runs/${encodeURIComponent(run)}/episodes/${encodeURIComponent(collection)}/${row}`;

/** Gets the rows of a collection of episodes from index `from` on. */
export function episodes(run, collection, generation, from) {
  return get(`runs/${encodeURIComponent(run)}/episodes/${encodeURIComponent(collection)}`, { generation, from });
}

/** Gets an episode, whose name is its run, collection and row. */
export const episode = (name, signal) => get(ofEpisode(...name), {}, signal);

/** Gets the solids of an episode and their poses; null if the task has no solids. */
export const scenes = (name, signal) => get(`${ofEpisode(...name)}/scenes`, {}, signal);

/** Gets the pictures that the environment renders of an episode: for each, the number of its state and a file. */
export async function pictures(name, signal) {
  const bytes = await (await answered(`${ofEpisode(...name)}/pictures`, {}, signal)).arrayBuffer();
  const [view, found] = [new DataView(bytes), []];
  for (let at = 0; at < bytes.byteLength;) {
    const [state, length] = [view.getUint32(at, true), view.getUint32(at + 4, true)];
    at += 8;
    found.push({ state, file: new Blob([bytes.slice(at, at + length)], { type: "image/png" }) });
    at += length;
  }
  return found;
}

/** Gets estimates of the reward model in the newest checkpoint for an episode's observations. */
export const proximity = (name, signal) => get(`${ofEpisode(...name)}/proximity`, {}, signal);

/** Gets estimates of the reward model in a checkpoint with the agent on every free cell of an episode's grid. */
export const grid = (name, checkpoint, signal) => get(`${ofEpisode(...name)}/grid`, { checkpoint }, signal);

/** Scores an episode under another reward: settings such as `reward.form=absolute`, and the run whose model scores. */
export function reward(name, settings, model, signal) {
  return get(`${ofEpisode(...name)}/reward`, { with: settings, ...(model ? { model } : {}) }, signal);
}

/**
 * Calls `onruns` with every new list of runs, and `ontrouble` with what keeps them away, or an empty text. A hidden tab
 * does not listen: browsers open few connections to a server, and another tab may need this one.
 */
export function listen(onruns, ontrouble) {
  let source = null;
  const open = () => {
    const own = new EventSource(address("events"));
    source = own;
    own.addEventListener("runs", (event) => onruns(JSON.parse(event.data)));
    own.addEventListener("open", () => ontrouble(""));
    own.addEventListener("error", () => {
      if (own.readyState !== EventSource.CLOSED) {
        ontrouble("No server answers here. A training's page ends with it; `goalward page` serves its runs. This page reconnects automatically.");
        return;
      }
      // The server has refused. A browser then does not reconnect, and only a plain request says why.
      const unlessLeft = (act) => (told) => { if (source === own) act(told); };
      get("runs").then(
        unlessLeft((list) => { ontrouble(""); onruns(list); }),
        unlessLeft((error) => ontrouble(`The runs cannot be read: ${error.message}`)),
      );
      setTimeout(unlessLeft(open), 2000);
    });
  };
  const follow = () => {
    if (!document.hidden) {
      // The server sends the list at once.
      if (source === null) open();
      return;
    }
    source?.close();
    source = null;
    ontrouble("");
  };
  document.addEventListener("visibilitychange", follow);
  follow();
}
